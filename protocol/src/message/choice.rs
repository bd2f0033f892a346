//! The streams that a member chooses, and why one takes the place of another.
//!
//! Codec only: the server starts and ends streams, and decides when a link is congested.

use rhumb_reckoning::{LengthBound, Tolerance, TurnBound};

use crate::stream::Budget;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The cause of a member's request for a new snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResyncCause {
    /// Too many packets are missing for refreshes.
    LostSync,
    /// A checksum of the stream differs from that of the copy: a fault of the publisher or of the subscriber.
    ChecksumMismatch,
}

impl Wire for ResyncCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::LostSync => 0,
            Self::ChecksumMismatch => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::LostSync),
            1 => Ok(Self::ChecksumMismatch),
            _ => Err(Malformed::OutOfRange),
        }
    }
}

/// A stream of a scene that a member chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StreamChoice {
    /// Predicted, within this tolerance.
    Within(Tolerance),
    /// The same under a budget: where the budget does not suffice, the stream states its error scale.
    Capped {
        /// Tolerance while the budget suffices.
        tolerance: Tolerance,
        /// Bandwidth budget.
        budget: Budget,
    },
    /// Every state at every tick, exact.
    Full,
    /// Every state that changed, exact: a full stream without the bodies that rest.
    Changed,
}

impl StreamChoice {
    /// True for a stream of exact states.
    #[must_use]
    pub const fn is_exact(self) -> bool {
        matches!(self, Self::Full | Self::Changed)
    }

    /// Tolerance of a copy by this stream. A full or changed stream is exact: for it the value means nothing.
    #[must_use]
    pub const fn tolerance(self) -> Tolerance {
        match self {
            Self::Within(tolerance) | Self::Capped { tolerance, .. } => tolerance,
            Self::Full | Self::Changed => Tolerance::LEAST,
        }
    }
}

impl Wire for StreamChoice {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Within(Tolerance::Surface(length)) => {
                to.u8(0);
                to.varint(u64::from(length.micrometres()));
            }
            Self::Full => to.u8(1),
            Self::Changed => to.u8(4),
            Self::Within(Tolerance::Parts { position, turn }) => {
                to.u8(2);
                to.varint(u64::from(position.micrometres()));
                to.varint(u64::from(turn.microradians()));
            }
            Self::Capped { tolerance, budget } => {
                to.u8(CAPPED);
                budget.encode(to);
                Self::Within(*tolerance).encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let code = from.u8()?;
        if code != CAPPED {
            return Self::uncapped(code, from);
        }
        let budget = Budget::decode(from)?;
        match Self::uncapped(from.u8()?, from)? {
            Self::Within(tolerance) => Ok(Self::Capped { tolerance, budget }),
            Self::Full | Self::Changed | Self::Capped { .. } => Err(Malformed::UnknownCode),
        }
    }
}

/// Code before a budget and the choice that it limits.
const CAPPED: u8 = 3;

impl StreamChoice {
    /// Decodes a choice without a budget, after its code.
    fn uncapped(code: u8, from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match code {
            0 => Self::Within(Tolerance::Surface(decode_length(from)?)),
            1 => Self::Full,
            4 => Self::Changed,
            2 => Self::Within(Tolerance::Parts {
                position: decode_length(from)?,
                turn: TurnBound::from_microradians(from.varint32()?)
                    .map_err(|_| Malformed::OutOfRange)?,
            }),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

fn decode_length(from: &mut Reader<'_>) -> Result<LengthBound, Malformed> {
    LengthBound::from_micrometres(from.varint32()?).map_err(|_| Malformed::OutOfRange)
}

/// Reason of a tier change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TierChangeCause {
    /// The link could not carry the stream.
    LinkCongested,
    /// The link has carried the coarser stream with ease for long enough to try the finer one again.
    LinkRecovered,
}

impl Wire for TierChangeCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::LinkCongested => 0,
            Self::LinkRecovered => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::LinkCongested),
            1 => Ok(Self::LinkRecovered),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// Tiers that the server may choose when a member's link is congested.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TierPolicy {
    /// None: late and lossy state is preferred to coarse state.
    Never,
    /// Tiers up to this tolerance.
    UpTo(LengthBound),
}

impl Wire for TierPolicy {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Never => to.u8(0),
            Self::UpTo(coarsest) => {
                to.u8(1);
                to.varint(u64::from(coarsest.micrometres()));
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Never),
            1 => LengthBound::from_micrometres(from.varint32()?)
                .map(Self::UpTo)
                .map_err(|_| Malformed::OutOfRange),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<StreamChoice, Malformed> {
        let mut reader = Reader::new(bytes);
        let choice = StreamChoice::decode(&mut reader)?;
        reader.finish()?;
        Ok(choice)
    }

    #[test]
    fn a_stream_choice_round_trips() {
        let parts = |micrometres, microradians| {
            StreamChoice::Within(Tolerance::Parts {
                position: LengthBound::from_micrometres(micrometres).unwrap(),
                turn: TurnBound::from_microradians(microradians).unwrap(),
            })
        };
        for (choice, bytes) in [
            (
                StreamChoice::Within(Tolerance::NORMAL),
                &[0, 0xd0, 0x86, 3][..],
            ),
            (StreamChoice::Full, &[1][..]),
            (StreamChoice::Changed, &[4][..]),
            (parts(10_000, 2_000), &[2, 0x90, 0x4e, 0xd0, 0x0f][..]),
            (
                parts(1_000, 3_141_593),
                &[2, 0xe8, 7, 0xd9, 0xdf, 0xbf, 1][..],
            ),
            (
                StreamChoice::Capped {
                    tolerance: Tolerance::NORMAL,
                    budget: Budget::new(8_000, 2_000).unwrap(),
                },
                &[3, 0xc0, 0x3e, 0xd0, 0x0f, 0, 0xd0, 0x86, 3][..],
            ),
        ] {
            let mut writer = Writer::new();
            choice.encode(&mut writer);
            assert_eq!(writer.into_bytes(), bytes);
            assert_eq!(read(bytes), Ok(choice));
            for cut in 0..bytes.len() {
                assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
            }
        }
    }

    #[test]
    fn an_invalid_tolerance_is_refused() {
        for (first, numbers) in [
            (0, &[999_u64][..]),
            (0, &[10_000_001][..]),
            (2, &[999, 2_000][..]),
            (2, &[10_000, 99][..]),
            (2, &[10_000, 3_141_594][..]),
        ] {
            let mut writer = Writer::new();
            writer.u8(first);
            numbers.iter().for_each(|number| writer.varint(*number));
            let refused = read(&writer.into_bytes());
            assert_eq!(refused, Err(Malformed::OutOfRange), "{numbers:?}");
        }
        assert_eq!(read(&[5]), Err(Malformed::UnknownCode));
        // A full or changed stream has no budget, and a budget is not nested.
        for inner in [1, 3, 4] {
            let refused = read(&[3, 0xc0, 0x3e, 0xd0, 0x0f, inner]);
            assert_eq!(refused, Err(Malformed::UnknownCode));
        }
    }

    #[test]
    fn valid_tier_policies_round_trip_and_others_are_refused() {
        let coarse = LengthBound::from_micrometres(200_000).unwrap();
        for (tier_policy, bytes) in [
            (TierPolicy::Never, &[0][..]),
            (TierPolicy::UpTo(coarse), &[1, 0xc0, 0x9a, 0x0c][..]),
        ] {
            let mut writer = Writer::new();
            tier_policy.encode(&mut writer);
            assert_eq!(writer.into_bytes(), bytes);
            assert_eq!(TierPolicy::decode(&mut Reader::new(bytes)), Ok(tier_policy));
        }
        let refused = |bytes: &[u8]| TierPolicy::decode(&mut Reader::new(bytes)).unwrap_err();
        assert_eq!(refused(&[1, 1]), Malformed::OutOfRange);
        assert_eq!(refused(&[2]), Malformed::UnknownCode);
        let unknown = TierChangeCause::decode(&mut Reader::new(&[2]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
    }
}
