//! What every datagram begins with.

use core::fmt;

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Names one stream of one scene; told to a member when it joins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamId(pub u32);

impl StreamId {
    /// The names that take no byte of a datagram.
    pub const SMALL: core::ops::Range<u32> = 0..15;
}

impl fmt::Display for StreamId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "stream {}", self.0)
    }
}

impl Wire for StreamId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.varint32().map(Self)
    }
}

/// The low 16 bits of a count that both ends know roughly: packet numbers, ticks, scene_events (PROTOCOL 5.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Low16(pub u16);

impl Low16 {
    /// Of a keyframe count.
    #[must_use]
    pub const fn of(count: u64) -> Self {
        Self(count as u16)
    }

    /// The count nearest to `near` that has these low bits; at a tie the higher one.
    #[must_use]
    pub const fn expand(self, near: u64) -> u64 {
        let behind = near.wrapping_sub(self.0 as u64) & 0xffff;
        let below = near.wrapping_sub(behind);
        // `below` is at or under `near`; when it would lie under zero, or is farther than half a turn, go up a turn.
        if behind >= 0x8000 || behind > near {
            below.wrapping_add(0x1_0000)
        } else {
            below
        }
    }

    /// Appends the two bytes.
    pub fn encode(self, to: &mut Writer) {
        to.u16(self.0);
    }

    /// Takes two bytes.
    ///
    /// # Errors
    ///
    /// [`Malformed::Truncated`].
    pub fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.u16().map(Self)
    }
}

/// What a datagram is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PacketKind {
    /// Updates of a stream; part of a tick of which more packets follow.
    Updates,
    /// Updates of a stream; the last packet of its tick.
    UpdatesEnd,
    /// Nothing was said up to a tick.
    Watermark,
    /// What the bodies of a lost packet do now.
    Refresh,
    /// Every body's keyframe state; part of a tick of which more packets follow.
    Full,
    /// Every body's keyframe state; the last packet of its tick.
    FullEnd,
    /// From a member: what it heard and what it lost.
    LossReport,
    /// Sums over tracks.
    Checksums,
    /// A sum over the last packets, from which a lost one can be had.
    RepairSymbol,
    /// Updates of a stream with a budget; the last packet of its tick, and something was over_budget.
    UpdatesOverBudget,
    /// Nothing was said up to a tick of a stream with a budget, though something should have been.
    WatermarkOverBudget,
}

impl PacketKind {
    const CODES: [(u8, Self); 11] = [
        (0, Self::Updates),
        (1, Self::UpdatesEnd),
        (2, Self::Watermark),
        (3, Self::Refresh),
        (4, Self::Full),
        (5, Self::FullEnd),
        (6, Self::LossReport),
        (7, Self::Checksums),
        (9, Self::RepairSymbol),
        (11, Self::UpdatesOverBudget),
        (12, Self::WatermarkOverBudget),
    ];
}

/// The first byte of a datagram, or more of a stream with a large name: its kind and its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// What it is.
    pub kind: PacketKind,
    /// Whose.
    pub stream: StreamId,
}

impl Wire for Head {
    fn encode(&self, to: &mut Writer) {
        let (code, _) = PacketKind::CODES
            .into_iter()
            .find(|(_, kind)| *kind == self.kind)
            .expect("every kind has a code");
        let StreamId(stream) = self.stream;
        let small = stream.min(LARGE);
        to.u8(code | (small as u8) << KIND_BITS);
        if small == LARGE {
            to.varint(u64::from(stream - LARGE));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let first = from.u8()?;
        let (code, small) = (first & ((1 << KIND_BITS) - 1), first >> KIND_BITS);
        let (_, kind) = PacketKind::CODES
            .into_iter()
            .find(|(known, _)| *known == code)
            .ok_or(Malformed::UnknownCode)?;
        let mut stream = u32::from(small);
        if stream == LARGE {
            stream = stream
                .checked_add(from.varint32()?)
                .ok_or(Malformed::OutOfRange)?;
        }
        let stream = StreamId(stream);
        Ok(Self { kind, stream })
    }
}

/// A datagram of which the head was read.
#[derive(Clone, Copy, Debug)]
pub struct Datagram<'a> {
    head: Head,
    body: &'a [u8],
}

impl<'a> Datagram<'a> {
    /// Reads the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when there is none, or its kind is unknown.
    pub fn open(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let mut reader = Reader::new(bytes);
        let head = Head::decode(&mut reader)?;
        let body = reader.rest();
        Ok(Self { head, body })
    }

    /// One whose head was read before.
    pub(crate) const fn opened(head: Head, body: &'a [u8]) -> Self {
        Self { head, body }
    }

    /// Its kind and its stream.
    #[must_use]
    pub const fn head(&self) -> Head {
        self.head
    }

    /// Reads what follows the head.
    #[must_use]
    pub const fn body(&self) -> Reader<'a> {
        Reader::new(self.body)
    }
}

/// Low bits of a datagram's first byte that are its kind.
const KIND_BITS: u32 = 4;
/// Streams below this one are named in the rest of that byte.
const LARGE: u32 = StreamId::SMALL.end;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_head_comes_back(code in 0..PacketKind::CODES.len(), stream in prop_oneof![0_u32..20, any::<u32>()]) {
            let (_, kind) = PacketKind::CODES[code];
            let stream = StreamId(stream);
            let mut to = Writer::new();
            Head { kind, stream }.encode(&mut to);
            let bytes = to.into_bytes();
            prop_assert_eq!(bytes.len() == 1, StreamId::SMALL.contains(&stream.0));
            let mut from = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut from), Ok(Head { kind, stream }));
            prop_assert_eq!(from.finish(), Ok(()));
        }

        #[test]
        fn low_bits_grow_back_near_where_they_were_cut(count in 0_u64..1 << 40, off in -32_000_i64..32_000) {
            let near = count.saturating_add_signed(off);
            prop_assert_eq!(Low16::of(count).expand(near), count);
        }

        #[test]
        fn low_bits_never_grow_below_zero(low: u16, near in 0_u64..100_000) {
            let grown = Low16(low).expand(near);
            prop_assert_eq!(grown as u16, low);
            prop_assert!(grown.abs_diff(near) <= 0x1_0000);
        }
    }
}
