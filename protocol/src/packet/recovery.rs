//! Answers to lost packets: loss reports, refreshes, checksums.
//!
//! A refresh holds the present tracks of the bodies in a lost packet, as keyframes with their ages, so it can be read
//! without any other packet. A refresh that exceeds a datagram is split into parts; each part is useful alone. Codec
//! only: `stream/state_checksum` computes the checksum over all tracks.

use alloc::vec::Vec;

use rhumb_reckoning::Ticks;

use super::LargestPacket;
use super::header::{Head, Low16, PacketKind, StreamId};
use super::keyframe::Keyframe;
use super::payload::AGE_MAX;
use crate::limits::{
    DATAGRAM_BYTES_MAX, FEC_SPAN, INDICES_MAX, LARGEST_PACKET_MIN, LOST_NUMBERS_MAX,
    REFRESH_PARTS_MAX, UPDATES_PER_PACKET_MAX,
};
use crate::wire::bits::{BitReader, BitWriter, PutBits, TakeBits, golomb_len};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A receiver's report about its stream. It requests a refresh of each lost packet and a watermark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LossReport {
    /// Low bits of one more than the number of the newest packet known to have been sent.
    pub next: Low16,
    /// Low bits of the count of packets that did not arrive, whether or not repair symbols recovered them.
    pub abandoned: Low16,
    /// The number of repair symbols that would recover the newest losses; zero if refreshes are needed.
    pub repair_symbols: u8,
    /// Numbers of lost packets below `next`, oldest first.
    pub lost: Vec<Low16>,
}

impl LossReport {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: PacketKind::LossReport,
            stream,
        }
        .encode(&mut to);
        self.next.encode(&mut to);
        self.abandoned.encode(&mut to);
        to.u8(self.repair_symbols);
        to.varint(self.lost.len() as u64);
        for lost in &self.lost {
            lost.encode(&mut to);
        }
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no loss report.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let abandoned = Low16::decode(&mut from)?;
        let repair_symbols = from.u8()?;
        if u32::from(repair_symbols) > FEC_SPAN {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint()?;
        if count > LOST_NUMBERS_MAX as u64 {
            return Err(Malformed::TooLong);
        }
        let mut lost = Vec::new();
        for _ in 0..count {
            lost.push(Low16::decode(&mut from)?);
        }
        from.finish()?;
        Ok(Self {
            next,
            abandoned,
            repair_symbols,
            lost,
        })
    }
}

/// Orders of the codes of a record's index gap, alias and age.
const GAP_ORDER: u32 = 3;
const ALIAS_ORDER: u32 = 5;
const AGE_ORDER: u32 = 4;

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

/// The checksum over a publisher's tracks after its newest packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checksums {
    /// Number of the stream's next packet: the checksum covers all packets before it.
    pub next: Low16,
    /// Low bits of the tick up to which everything was sent.
    pub tick: Low16,
    /// Low bits of the count of scene events up to that tick.
    pub scene_events: Low16,
    /// The checksum over the tracks of all bodies.
    pub sum: u64,
}

impl Checksums {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = PacketKind::Checksums;
        Head { kind, stream }.encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        to.raw(&self.sum.to_le_bytes());
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if the body is no checksum packet.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let mut sum = [0; 8];
        sum.copy_from_slice(from.raw(8)?);
        from.finish()?;
        Ok(Self {
            next,
            tick,
            scene_events,
            sum: u64::from_le_bytes(sum),
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Predictor};

    use super::*;

    proptest! {
        #[test]
        fn a_loss_report_round_trips(next: u16, abandoned: u16, repair_symbols in 0..=FEC_SPAN as u8, lost in proptest::collection::vec(any::<u16>(), 0..LOST_NUMBERS_MAX)) {
            let (next, abandoned) = (Low16(next), Low16(abandoned));
            let loss_report = LossReport { next, abandoned, repair_symbols, lost: lost.into_iter().map(Low16).collect() };
            let bytes = loss_report.encode(StreamId(300));
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: PacketKind::LossReport, stream: StreamId(300) }));
            prop_assert_eq!(LossReport::decode(reader.clone()), Ok(loss_report));
            for cut in 0..reader.rest().len() {
                prop_assert!(LossReport::decode(Reader::new(&reader.rest()[..cut])).is_err());
            }
        }
    }

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

    #[test]
    fn a_checksum_packet_has_these_bytes() {
        let checksums = Checksums {
            next: Low16(0x1170),
            tick: Low16(300),
            scene_events: Low16(12),
            sum: 0x0102_0304_0506_0708,
        };
        let bytes = checksums.encode(StreamId(5));
        let expected = [0x57, 0x70, 0x11, 0x2c, 1, 12, 0, 8, 7, 6, 5, 4, 3, 2, 1];
        assert_eq!(bytes, expected);
        let mut reader = Reader::new(&bytes);
        assert!(Head::decode(&mut reader).is_ok());
        assert_eq!(Checksums::decode(reader.clone()), Ok(checksums));
        for cut in 0..reader.rest().len() {
            assert!(Checksums::decode(Reader::new(&reader.rest()[..cut])).is_err());
        }
    }
}
