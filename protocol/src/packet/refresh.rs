//! The refresh: present tracks of the bodies in a lost packet.
//!
//! A refresh holds keyframes with their ages, so it can be read without any other packet. A refresh that exceeds a
//! datagram is split into parts; each part is useful alone.

use alloc::vec::Vec;

use rhumb_reckoning::Ticks;

use super::header::{Head, Low16, PacketKind, StreamId};
use super::keyframe::Keyframe;
use super::largest_packet::LargestPacket;
use crate::limits::{
    DATAGRAM_BYTES_MAX, INDICES_MAX, LARGEST_PACKET_MIN, REFRESH_PARTS_MAX, UPDATES_PER_PACKET_MAX,
};
use crate::wire::bits::{BitReader, BitWriter, PutBits, TakeBits, golomb_len};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Orders of the codes of a record's index gap, alias and age.
const GAP_ORDER: u32 = 3;
const ALIAS_ORDER: u32 = 5;
const AGE_ORDER: u32 = 4;
/// An older track is encoded with this age: half a year at 60 Hz.
pub(crate) const AGE_MAX: u32 = 1 << 30;

/// One body's track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefreshRecord {
    /// Index of the body.
    pub index: u32,
    /// Its alias, if it has one.
    pub alias: Option<u32>,
    /// Ticks from the track's origin to the tick of the refresh.
    pub age: Ticks,
    /// The track, without its origin.
    pub keyframe: Keyframe,
}

/// One part of a refresh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refresh {
    /// Low bits of the lost packet's number.
    pub lost: Low16,
    /// Low bits of the tick to which the ages refer.
    pub tick: Low16,
    /// Low bits of the count of scene events that the reader must have received.
    pub scene_events: Low16,
    /// The index of this part.
    pub part: u8,
    /// The number of parts; at least one.
    pub parts: u8,
    /// The records, in rising order of index.
    pub records: Vec<RefreshRecord>,
}

impl Refresh {
    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no part of a refresh.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let lost = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let (part, parts) = (from.u8()?, from.u8()?);
        if part >= parts || parts > REFRESH_PARTS_MAX {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint_to((DATAGRAM_BYTES_MAX * 8) as u64)?;
        let mut bits = BitReader::new(from.rest());
        let mut records = Vec::new();
        let mut next_index = 0_u32;
        for _ in 0..count {
            let gap = bits.golomb(GAP_ORDER)?;
            let index = next_index.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            let alias = bits.golomb(ALIAS_ORDER)?.checked_sub(1);
            let age = bits.golomb(AGE_ORDER)?;
            if index >= INDICES_MAX
                || age > AGE_MAX
                || alias.is_some_and(|alias| alias >= INDICES_MAX)
            {
                return Err(Malformed::OutOfRange);
            }
            let keyframe = Keyframe::decode(&mut bits)?;
            let age = Ticks::new(age);
            records.push(RefreshRecord {
                index,
                alias,
                age,
                keyframe,
            });
            next_index = index + 1;
        }
        bits.finish()?;
        Ok(Self {
            lost,
            tick,
            scene_events,
            part,
            parts,
            records,
        })
    }
}

/// Bytes before the records.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2 + 2 + 2;

/// Splits records into the datagrams of one refresh.
#[derive(Debug)]
pub struct RefreshWriter {
    largest_packet: LargestPacket,
    parts: Vec<(u16, Vec<u8>)>,
    bits: BitWriter,
    next_index: u32,
    count: u16,
}

impl Default for RefreshWriter {
    /// Makes datagrams as large as the protocol allows.
    fn default() -> Self {
        Self::within(LargestPacket::GREATEST)
    }
}

impl RefreshWriter {
    /// Makes datagrams of at most this size.
    #[must_use]
    pub fn within(largest_packet: LargestPacket) -> Self {
        Self {
            largest_packet,
            parts: Vec::new(),
            bits: BitWriter::default(),
            next_index: 0,
            count: 0,
        }
    }

    /// Appends a record, in rising order of index.
    pub fn push(&mut self, record: &RefreshRecord) {
        let age = record.age.count().min(AGE_MAX);
        let gap = record.index - self.next_index;
        let alias = record.alias.map_or(0, |alias| alias + 1);
        let bits = golomb_len(record.index, GAP_ORDER)
            + golomb_len(alias, ALIAS_ORDER)
            + golomb_len(age, AGE_ORDER);
        let bits = bits as usize + record.keyframe.bit_len();
        let full = self.bits.bit_len() + bits > (self.largest_packet.bytes() - HEAD_BYTES_MAX) * 8;
        let gap = if full {
            self.end_part();
            record.index
        } else {
            gap
        };
        self.bits.golomb(gap, GAP_ORDER);
        self.bits.golomb(alias, ALIAS_ORDER);
        self.bits.golomb(age, AGE_ORDER);
        record.keyframe.encode(&mut self.bits);
        self.next_index = record.index + 1;
        self.count += 1;
    }

    fn end_part(&mut self) {
        let bits = core::mem::take(&mut self.bits);
        self.parts.push((self.count, bits.into_bytes()));
        self.next_index = 0;
        self.count = 0;
    }

    /// The datagrams; one without records if no body of the lost packet needs a refresh.
    #[must_use]
    pub fn finish(
        mut self,
        stream: StreamId,
        lost: u64,
        tick: u64,
        scene_events: u64,
    ) -> Vec<Vec<u8>> {
        self.end_part();
        let parts = self.parts.len() as u8;
        let part_bytes = |(part, (count, bits)): (usize, (u16, Vec<u8>))| {
            let mut to = Writer::new();
            Head {
                kind: PacketKind::Refresh,
                stream,
            }
            .encode(&mut to);
            Low16::of(lost).encode(&mut to);
            Low16::of(tick).encode(&mut to);
            Low16::of(scene_events).encode(&mut to);
            to.u8(part as u8);
            to.u8(parts);
            to.varint(u64::from(count));
            to.raw(&bits);
            to.into_bytes()
        };
        self.parts.into_iter().enumerate().map(part_bytes).collect()
    }
}

// The bodies of the fullest packet fit the parts of a refresh, also in the smallest datagrams.
const _: () = assert!(
    UPDATES_PER_PACKET_MAX * (Keyframe::BITS_MAX + 100)
        <= REFRESH_PARTS_MAX as usize
            * (LARGEST_PACKET_MIN - HEAD_BYTES_MAX - Keyframe::BITS_MAX / 8)
            * 8
);

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_reckoning::{Anchor, BodyState, Predictor};

    fn record(index: u32) -> RefreshRecord {
        let moving =
            BodyState::new([index as f32; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [2.0; 3]).unwrap();
        RefreshRecord {
            index,
            alias: (!index.is_multiple_of(3)).then_some(index / 2),
            age: Ticks::new(index % 1_000),
            keyframe: Keyframe {
                predictor: Predictor::Ballistic,
                anchor: Anchor::Exact(moving),
                parent: None,
            },
        }
    }

    fn decode(datagram: &[u8]) -> Refresh {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader).unwrap().kind, PacketKind::Refresh);
        Refresh::decode(reader).unwrap()
    }

    #[test]
    fn refresh_parts_decode_independently() {
        let mut writer = RefreshWriter::default();
        let written: Vec<_> = (0..100).map(|i| record(i * 7)).collect();
        for one in &written {
            writer.push(one);
        }
        let datagrams = writer.finish(StreamId(1), 5, 6, 7);
        assert!(datagrams.len() > 1);
        let mut received = Vec::new();
        for (part, datagram) in datagrams.iter().enumerate() {
            assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            let refresh = decode(datagram);
            assert_eq!(
                (usize::from(refresh.part), usize::from(refresh.parts)),
                (part, datagrams.len())
            );
            received.extend(refresh.records);
        }
        assert_eq!(received, written);
    }

    #[test]
    fn empty_refresh_is_encoded() {
        let datagrams = RefreshWriter::default().finish(StreamId(1), 5, 6, 7);
        assert_eq!(datagrams.len(), 1);
        assert_eq!(decode(&datagrams[0]).records, []);
        for cut in 2..datagrams[0].len() {
            assert_eq!(
                Refresh::decode(Reader::new(&datagrams[0][2..cut])),
                Err(Malformed::Truncated)
            );
        }
    }
}
