//! Sums over tracks, as they are said and asked for.
//!
//! Codec only; what a sum is made of is in `stream/state_checksum`.

use alloc::vec::Vec;

use super::header::{Head, Low16, PacketKind, StreamId};
use crate::limits::{CHECKSUM_RANGES_MAX, INDICES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A run of body indices, cut into ranges of one length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexRanges {
    /// The first index of the first range.
    pub first: u32,
    /// Indices in each range; at least one.
    pub stride: u32,
}

impl IndexRanges {
    /// All indices in one range.
    pub const ALL: Self = Self {
        first: 0,
        stride: INDICES_MAX,
    };

    /// This range cut into as many as one checksums holds.
    #[must_use]
    pub const fn cut(self) -> Self {
        Self {
            first: self.first,
            stride: self.stride.div_ceil(CHECKSUM_RANGES_MAX as u32),
        }
    }

    fn encode(self, to: &mut Writer) {
        to.varint(u64::from(self.first));
        to.varint(u64::from(self.stride));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let most = u64::from(INDICES_MAX);
        let ranges = Self {
            first: from.varint_to(most - 1)? as u32,
            stride: from.varint_to(most)? as u32,
        };
        if ranges.stride == 0 {
            return Err(Malformed::OutOfRange);
        }
        Ok(ranges)
    }
}

/// The sums over a publisher's tracks by ranges, when a packet was its last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checksums {
    /// Number of the stream's next packet: the sums are over what all before it said.
    pub next: Low16,
    /// Up to this tick nothing more was to be said.
    pub tick: Low16,
    /// SceneEvents given by then, all included.
    pub scene_events: Low16,
    /// Of which bodies the first sum is.
    pub ranges: IndexRanges,
    /// The sums, one a range.
    pub sums: Vec<u64>,
}

impl Checksums {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = PacketKind::Checksums;
        Head { kind, stream }.encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        self.ranges.encode(&mut to);
        to.varint(self.sums.len() as u64);
        for sum in &self.sums {
            to.raw(&sum.to_le_bytes());
        }
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a checksums.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let ranges = IndexRanges::decode(&mut from)?;
        let count = from.varint_to(CHECKSUM_RANGES_MAX as u64)?;
        let mut sums = Vec::new();
        for _ in 0..count {
            let mut bytes = [0; 8];
            bytes.copy_from_slice(from.raw(8)?);
            sums.push(u64::from_le_bytes(bytes));
        }
        from.finish()?;
        Ok(Self {
            next,
            tick,
            scene_events,
            ranges,
            sums,
        })
    }
}

/// From a member: its sum over these bodies is another. It asks for the sums over parts of them, or, if it is one body,
/// for its track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ChecksumMismatch {
    /// One range.
    pub range: IndexRanges,
}

impl ChecksumMismatch {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = PacketKind::ChecksumMismatch;
        Head { kind, stream }.encode(&mut to);
        self.range.encode(&mut to);
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a mismatch.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let range = IndexRanges::decode(&mut from)?;
        from.finish()?;
        Ok(Self { range })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ranges() -> impl Strategy<Value = IndexRanges> {
        (0..INDICES_MAX, 1..=INDICES_MAX).prop_map(|(first, stride)| IndexRanges { first, stride })
    }

    #[test]
    fn a_digest_of_a_whole_stream_is_these_bytes() {
        let checksums = Checksums {
            next: Low16(0x1170),
            tick: Low16(300),
            scene_events: Low16(12),
            ranges: IndexRanges::ALL,
            sums: alloc::vec![0x0102_0304_0506_0708],
        };
        let bytes = checksums.encode(StreamId(5));
        let expected = [
            0x57, 0x70, 0x11, 0x2c, 1, 12, 0, 0, 0x80, 0x80, 0x40, 1, 8, 7, 6, 5, 4, 3, 2, 1,
        ];
        assert_eq!(bytes, expected);
    }

    #[test]
    fn a_range_is_cut_until_it_is_one_body() {
        let mut range = IndexRanges::ALL;
        let mut cuts = 0;
        while range.stride > 1 {
            range = range.cut();
            cuts += 1;
        }
        assert_eq!(cuts, 3);
    }

    proptest! {
        #[test]
        fn checksum_packets_and_mismatches_come_back(
            next: u16, tick: u16, scene_events: u16, ranges in ranges(),
            sums in proptest::collection::vec(any::<u64>(), 0..CHECKSUM_RANGES_MAX),
        ) {
            let (next, tick, scene_events) = (Low16(next), Low16(tick), Low16(scene_events));
            let checksums = Checksums { next, tick, scene_events, ranges, sums };
            let bytes = checksums.encode(StreamId(300));
            prop_assert!(bytes.len() <= crate::limits::DATAGRAM_BYTES_MAX);
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: PacketKind::Checksums, stream: StreamId(300) }));
            prop_assert_eq!(Checksums::decode(reader.clone()), Ok(checksums));
            for cut in 0..reader.rest().len() {
                prop_assert!(Checksums::decode(Reader::new(&reader.rest()[..cut])).is_err());
            }
            let bytes = ChecksumMismatch { range: ranges }.encode(StreamId(300));
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: PacketKind::ChecksumMismatch, stream: StreamId(300) }));
            prop_assert_eq!(ChecksumMismatch::decode(reader), Ok(ChecksumMismatch { range: ranges }));
        }
    }
}
