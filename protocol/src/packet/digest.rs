//! Sums over tracks, as they are said and asked for.
//!
//! Codec only; what a sum is made of is in `stream/agreement`.

use alloc::vec::Vec;

use super::header::{Head, Kind, Low16, StreamId};
use crate::limits::{DIGEST_RANGES_MAX, INDICES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A run of body indices, cut into ranges of one length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ranges {
    /// The first index of the first range.
    pub first: u32,
    /// Indices in each range; at least one.
    pub stride: u32,
}

impl Ranges {
    /// All indices in one range.
    pub const ALL: Self = Self {
        first: 0,
        stride: INDICES_MAX,
    };

    /// This range cut into as many as one digest holds.
    #[must_use]
    pub const fn cut(self) -> Self {
        Self {
            first: self.first,
            stride: self.stride.div_ceil(DIGEST_RANGES_MAX as u32),
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
pub struct Digest {
    /// Number of the stream's next packet: the sums are over what all before it said.
    pub next: Low16,
    /// Up to this tick nothing more was to be said.
    pub tick: Low16,
    /// Notices given by then, all included.
    pub notices: Low16,
    /// Of which bodies the first sum is.
    pub ranges: Ranges,
    /// The sums, one a range.
    pub sums: Vec<u64>,
}

impl Digest {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = Kind::Digest;
        Head { kind, stream }.encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.notices.encode(&mut to);
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
    /// [`Malformed`] when that is not a digest.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let notices = Low16::decode(&mut from)?;
        let ranges = Ranges::decode(&mut from)?;
        let count = from.varint_to(DIGEST_RANGES_MAX as u64)?;
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
            notices,
            ranges,
            sums,
        })
    }
}

/// From a member: its sum over these bodies is another. It asks for the sums over parts of them, or, if it is one body,
/// for its track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Doubt {
    /// One range.
    pub range: Ranges,
}

impl Doubt {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = Kind::Doubt;
        Head { kind, stream }.encode(&mut to);
        self.range.encode(&mut to);
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a doubt.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let range = Ranges::decode(&mut from)?;
        from.finish()?;
        Ok(Self { range })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ranges() -> impl Strategy<Value = Ranges> {
        (0..INDICES_MAX, 1..=INDICES_MAX).prop_map(|(first, stride)| Ranges { first, stride })
    }

    #[test]
    fn a_digest_of_a_whole_stream_is_these_bytes() {
        let digest = Digest {
            next: Low16(0x1170),
            tick: Low16(300),
            notices: Low16(12),
            ranges: Ranges::ALL,
            sums: alloc::vec![0x0102_0304_0506_0708],
        };
        let bytes = digest.encode(StreamId(5));
        let expected = [
            0x57, 0x70, 0x11, 0x2c, 1, 12, 0, 0, 0x80, 0x80, 0x40, 1, 8, 7, 6, 5, 4, 3, 2, 1,
        ];
        assert_eq!(bytes, expected);
    }

    #[test]
    fn a_range_is_cut_until_it_is_one_body() {
        let mut range = Ranges::ALL;
        let mut cuts = 0;
        while range.stride > 1 {
            range = range.cut();
            cuts += 1;
        }
        assert_eq!(cuts, 3);
    }

    proptest! {
        #[test]
        fn digests_and_doubts_come_back(
            next: u16, tick: u16, notices: u16, ranges in ranges(),
            sums in proptest::collection::vec(any::<u64>(), 0..DIGEST_RANGES_MAX),
        ) {
            let (next, tick, notices) = (Low16(next), Low16(tick), Low16(notices));
            let digest = Digest { next, tick, notices, ranges, sums };
            let bytes = digest.encode(StreamId(300));
            prop_assert!(bytes.len() <= crate::limits::DATAGRAM_BYTES_MAX);
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: Kind::Digest, stream: StreamId(300) }));
            prop_assert_eq!(Digest::decode(reader.clone()), Ok(digest));
            for cut in 0..reader.rest().len() {
                prop_assert!(Digest::decode(Reader::new(&reader.rest()[..cut])).is_err());
            }
            let bytes = Doubt { range: ranges }.encode(StreamId(300));
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: Kind::Doubt, stream: StreamId(300) }));
            prop_assert_eq!(Doubt::decode(reader), Ok(Doubt { range: ranges }));
        }
    }
}
