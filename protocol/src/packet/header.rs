//! The head of every datagram: its kind and its stream; the error scale.
//!
//! The error scale, the factor by which a stream may exceed its tolerances, is one byte. Only streams with a budget
//! send it, and only while the budget delays updates (PROTOCOL 5.17).

use core::fmt;

use crate::limits::DATAGRAM_BYTES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The id of a stream of a scene; a member learns it when it joins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamId(pub u32);

impl StreamId {
    /// The ids that fit the first byte of a datagram.
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

/// The low 16 bits of a count that both ends know roughly: packet numbers, ticks, scene events (PROTOCOL 5.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Low16(pub u16);

impl Low16 {
    /// The low bits of a full count.
    #[must_use]
    pub const fn of(count: u64) -> Self {
        Self(count as u16)
    }

    /// The count nearest to `near` with these low bits; the higher one at a tie.
    #[must_use]
    pub const fn expand(self, near: u64) -> u64 {
        let behind = near.wrapping_sub(self.0 as u64) & 0xffff;
        let below = near.wrapping_sub(behind);
        // `below` is at or below `near`. If it is negative, or farther than half the range, the next higher count is
        // nearer.
        if behind >= 0x8000 || behind > near {
            below.wrapping_add(0x1_0000)
        } else {
            below
        }
    }

    /// Appends two bytes.
    pub fn encode(self, to: &mut Writer) {
        to.u16(self.0);
    }

    /// Reads two bytes.
    ///
    /// # Errors
    ///
    /// [`Malformed::Truncated`].
    pub fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.u16().map(Self)
    }
}

/// The kind of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PacketKind {
    /// Updates of a stream; more packets of the same tick follow.
    Updates,
    /// Updates of a stream; the last packet of its tick.
    UpdatesEnd,
    /// Everything up to a tick was sent.
    Watermark,
    /// The present tracks of the bodies in a lost packet.
    Refresh,
    /// Every body's state; more packets of the same tick follow.
    Full,
    /// Every body's state; the last packet of its tick.
    FullEnd,
    /// From a member: the packets that it received and lost.
    LossReport,
    /// The checksum over the tracks.
    Checksums,
    /// A sum over recent packets, from which a lost one is recovered.
    RepairSymbol,
    /// Updates of a stream with a budget; the last packet of a tick at which some bodies exceed their tolerance.
    UpdatesOverBudget,
    /// Everything up to a tick of a stream with a budget was sent, and some bodies exceed their tolerance.
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

/// The first byte of a datagram, and more bytes for a large stream id: kind and stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// The kind of the datagram.
    pub kind: PacketKind,
    /// The stream that the datagram belongs to.
    pub stream: StreamId,
}

impl Head {
    /// The number of bytes that it takes.
    #[must_use]
    const fn byte_len(self) -> usize {
        let StreamId(stream) = self.stream;
        match stream.checked_sub(LARGE) {
            None => 1,
            Some(more) => 1 + (u32::BITS - (more | 1).leading_zeros()).div_ceil(7) as usize,
        }
    }
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

/// A datagram with a decoded head.
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
    /// [`Malformed`] if the datagram is longer than any may be, its head is incomplete or its kind unknown.
    pub fn open(bytes: &'a [u8]) -> Result<Self, Malformed> {
        if bytes.len() > DATAGRAM_BYTES_MAX {
            return Err(Malformed::TooLong);
        }
        let mut reader = Reader::new(bytes);
        let head = Head::decode(&mut reader)?;
        let body = reader.rest();
        Ok(Self { head, body })
    }

    /// A datagram from a head that was decoded before.
    pub(crate) const fn opened(head: Head, body: &'a [u8]) -> Self {
        Self { head, body }
    }

    /// The number of its bytes, with the head.
    #[must_use]
    pub(crate) const fn byte_len(&self) -> usize {
        self.head.byte_len() + self.body.len()
    }

    /// The kind and the stream.
    #[must_use]
    pub const fn head(&self) -> Head {
        self.head
    }

    /// A reader for the bytes after the head.
    #[must_use]
    pub const fn body(&self) -> Reader<'a> {
        Reader::new(self.body)
    }
}

/// The number of low bits in the first byte that hold the kind.
const KIND_BITS: u32 = 4;
/// Stream ids below this one fit the first byte.
const LARGE: u32 = StreamId::SMALL.end;

/// A factor on every tolerance of a stream: 2ⁿ (8 + k) / 8 with k below 8, rounded up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ErrorScale(u8);

impl ErrorScale {
    /// Every body is within its tolerance.
    pub const NONE: Self = Self(0);
    /// The factor is unknown and may have any size.
    pub const UNBOUNDED: Self = Self(255);

    /// The least error scale that covers an error of `share` tolerances.
    #[must_use]
    pub fn covering(share: f64) -> Self {
        let covers = |code: &u8| Self(*code).factor().is_none_or(|factor| share <= factor);
        (0..=255).find(covers).map_or(Self::UNBOUNDED, Self)
    }

    /// The factor; `None` for [`Self::UNBOUNDED`].
    #[must_use]
    pub fn factor(self) -> Option<f64> {
        if self == Self::UNBOUNDED {
            return None;
        }
        let eighths = 8 + u32::from(self.0 % 8);
        Some(f64::from(eighths) * f64::from(1_u32 << (self.0 / 8)) / 8.0)
    }

    /// Appends the byte.
    pub(super) fn encode(self, to: &mut Writer) {
        to.u8(self.0);
    }

    /// Reads the byte; [`Self::NONE`] is refused.
    pub(super) fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Err(Malformed::NotCanonical),
            code => Ok(Self(code)),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_head_round_trips(code in 0..PacketKind::CODES.len(), stream in prop_oneof![0_u32..20, any::<u32>()]) {
            let (_, kind) = PacketKind::CODES[code];
            let stream = StreamId(stream);
            let mut to = Writer::new();
            Head { kind, stream }.encode(&mut to);
            let bytes = to.into_bytes();
            prop_assert_eq!(bytes.len() == 1, StreamId::SMALL.contains(&stream.0));
            prop_assert_eq!(Head { kind, stream }.byte_len(), bytes.len());
            let mut from = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut from), Ok(Head { kind, stream }));
            prop_assert_eq!(from.finish(), Ok(()));
        }

        #[test]
        fn low_bits_expand_to_the_nearest_count(count in 0_u64..1 << 40, off in -32_000_i64..32_000) {
            let near = count.saturating_add_signed(off);
            prop_assert_eq!(Low16::of(count).expand(near), count);
        }

        #[test]
        fn low_bits_never_expand_below_zero(low: u16, near in 0_u64..100_000) {
            let grown = Low16(low).expand(near);
            prop_assert_eq!(grown as u16, low);
            prop_assert!(grown.abs_diff(near) <= 0x1_0000);
        }
    }

    #[test]
    fn factors_rise_from_one_by_an_eighth_at_most() {
        let mut last = ErrorScale::NONE.factor().unwrap();
        assert_eq!(last.to_bits(), 1.0_f64.to_bits());
        for code in 1..255 {
            let factor = ErrorScale(code).factor().unwrap();
            assert!(factor > last && factor <= last * 1.125, "{code}");
            assert_eq!(ErrorScale::covering(factor), ErrorScale(code));
            assert_eq!(
                ErrorScale::covering(last + (factor - last) * 0.5),
                ErrorScale(code)
            );
            last = factor;
        }
        assert_eq!(ErrorScale::UNBOUNDED.factor(), None);
    }

    #[test]
    fn nan_has_no_error_scale() {
        for share in [f64::NAN, f64::INFINITY, 1e300] {
            assert_eq!(ErrorScale::covering(share), ErrorScale::UNBOUNDED);
        }
        assert_eq!(ErrorScale::covering(0.3), ErrorScale::NONE);
    }
}
