//! The answer to a lost packet: what its bodies do now.
//!
//! A repair says whole tracks with their ages, so that it can be read without any other packet. One that does not fit a
//! datagram comes in parts, each of which is of use alone.

use alloc::vec::Vec;

use rhumb_reckoning::Ticks;

use super::header::{Head, Kind, Low16, StreamId};
use super::whole::TrackSaying;
use crate::limits::{DATAGRAM_BYTES_MAX, INDICES_MAX, REPAIR_PARTS_MAX};
use crate::wire::bits::{BitReader, BitWriter, PutBits, TakeBits, golomb_len};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Orders of the codes of a record's index gap, seat and age.
const GAP_ORDER: u32 = 3;
const SEAT_ORDER: u32 = 5;
const AGE_ORDER: u32 = 4;
/// A track older than half a year at 60 Hz is said as old as this.
pub(crate) const AGE_MAX: u32 = 1 << 30;

/// One body's whole track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RepairRecord {
    /// Index of the body.
    pub index: u32,
    /// Its seat, if it has one.
    pub seat: Option<u32>,
    /// Ticks from the track's origin to the tick of the repair.
    pub age: Ticks,
    /// The track.
    pub whole: TrackSaying,
}

/// One part of a repair.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Repair {
    /// Which packet was lost.
    pub lost: Low16,
    /// The tick whose tracks these are.
    pub tick: Low16,
    /// Notices that must have been heard to read it.
    pub notices: Low16,
    /// Which part this is.
    pub part: u8,
    /// Of how many; at least one.
    pub parts: u8,
    /// The tracks.
    pub records: Vec<RepairRecord>,
}

impl Repair {
    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a part of a repair.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let lost = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let notices = Low16::decode(&mut from)?;
        let (part, parts) = (from.u8()?, from.u8()?);
        if part >= parts || parts > REPAIR_PARTS_MAX {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint_to((DATAGRAM_BYTES_MAX * 8) as u64)?;
        let mut bits = BitReader::new(from.rest());
        let mut records = Vec::new();
        let mut next_index = 0_u32;
        for _ in 0..count {
            let gap = bits.golomb(GAP_ORDER)?;
            let index = next_index.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            let seat = bits.golomb(SEAT_ORDER)?.checked_sub(1);
            let age = bits.golomb(AGE_ORDER)?;
            if index >= INDICES_MAX || age > AGE_MAX || seat.is_some_and(|seat| seat >= INDICES_MAX)
            {
                return Err(Malformed::OutOfRange);
            }
            let whole = TrackSaying::decode(&mut bits)?;
            let age = Ticks::new(age);
            records.push(RepairRecord {
                index,
                seat,
                age,
                whole,
            });
            next_index = index + 1;
        }
        bits.finish()?;
        Ok(Self {
            lost,
            tick,
            notices,
            part,
            parts,
            records,
        })
    }
}

/// Bytes before the records.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2 + 2 + 2;

/// Splits records into the datagrams of one repair.
#[derive(Debug, Default)]
pub struct RepairWriter {
    parts: Vec<(u16, Vec<u8>)>,
    bits: BitWriter,
    next_index: u32,
    count: u16,
}

impl RepairWriter {
    /// Appends a record, in rising order of index.
    pub fn push(&mut self, record: &RepairRecord) {
        let age = record.age.count().min(AGE_MAX);
        let gap = record.index - self.next_index;
        let seat = record.seat.map_or(0, |seat| seat + 1);
        let bits = golomb_len(record.index, GAP_ORDER)
            + golomb_len(seat, SEAT_ORDER)
            + golomb_len(age, AGE_ORDER);
        let bits = bits as usize + record.whole.bit_len();
        let full = self.bits.bit_len() + bits > (DATAGRAM_BYTES_MAX - HEAD_BYTES_MAX) * 8;
        let gap = if full {
            self.end_part();
            record.index
        } else {
            gap
        };
        self.bits.golomb(gap, GAP_ORDER);
        self.bits.golomb(seat, SEAT_ORDER);
        self.bits.golomb(age, AGE_ORDER);
        record.whole.encode(&mut self.bits);
        self.next_index = record.index + 1;
        self.count += 1;
    }

    fn end_part(&mut self) {
        let bits = core::mem::take(&mut self.bits);
        self.parts.push((self.count, bits.into_bytes()));
        self.next_index = 0;
        self.count = 0;
    }

    /// The datagrams; one without records when there is nothing left to repair.
    #[must_use]
    pub fn finish(mut self, stream: StreamId, lost: u64, tick: u64, notices: u64) -> Vec<Vec<u8>> {
        self.end_part();
        let parts = self.parts.len() as u8;
        let part_bytes = |(part, (count, bits)): (usize, (u16, Vec<u8>))| {
            let mut to = Writer::new();
            Head {
                kind: Kind::Repair,
                stream,
            }
            .encode(&mut to);
            Low16::of(lost).encode(&mut to);
            Low16::of(tick).encode(&mut to);
            Low16::of(notices).encode(&mut to);
            to.u8(part as u8);
            to.u8(parts);
            to.varint(u64::from(count));
            to.raw(&bits);
            to.into_bytes()
        };
        self.parts.into_iter().enumerate().map(part_bytes).collect()
    }
}

/// So many records fit the parts of one repair, whatever they say.
pub(crate) const REPAIR_RECORDS: usize = 720;
const _: () = assert!(
    REPAIR_RECORDS * (TrackSaying::BITS_MAX + 100)
        <= REPAIR_PARTS_MAX as usize
            * (DATAGRAM_BYTES_MAX - HEAD_BYTES_MAX - TrackSaying::BITS_MAX / 8)
            * 8
);

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::{Anchor, Predictor, Verbatim};

    fn record(index: u32) -> RepairRecord {
        let moving =
            Verbatim::new([index as f32; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [2.0; 3]).unwrap();
        RepairRecord {
            index,
            seat: (!index.is_multiple_of(3)).then_some(index / 2),
            age: Ticks::new(index % 1_000),
            whole: TrackSaying {
                predictor: Predictor::Ballistic,
                anchor: Anchor::Verbatim(moving),
                carrier: None,
            },
        }
    }

    fn decode(datagram: &[u8]) -> Repair {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader).unwrap().kind, Kind::Repair);
        Repair::decode(reader).unwrap()
    }

    #[test]
    fn a_repair_of_many_bodies_comes_in_parts_that_read_alone() {
        let mut writer = RepairWriter::default();
        let asked: Vec<_> = (0..100).map(|i| record(i * 7)).collect();
        for one in &asked {
            writer.push(one);
        }
        let datagrams = writer.finish(StreamId(1), 5, 6, 7);
        assert!(datagrams.len() > 1);
        let mut heard = Vec::new();
        for (part, datagram) in datagrams.iter().enumerate() {
            assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            let repair = decode(datagram);
            assert_eq!(
                (usize::from(repair.part), usize::from(repair.parts)),
                (part, datagrams.len())
            );
            heard.extend(repair.records);
        }
        assert_eq!(heard, asked);
    }

    #[test]
    fn nothing_left_to_repair_is_said_too() {
        let datagrams = RepairWriter::default().finish(StreamId(1), 5, 6, 7);
        assert_eq!(datagrams.len(), 1);
        assert_eq!(decode(&datagrams[0]).records, []);
        for cut in 2..datagrams[0].len() {
            assert_eq!(
                Repair::decode(Reader::new(&datagrams[0][2..cut])),
                Err(Malformed::Truncated)
            );
        }
    }
}
