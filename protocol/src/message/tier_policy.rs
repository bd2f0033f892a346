//! Tier changes of a member's stream, and the policy that bounds them.
//!
//! The server decides when a link is congested.

use rhumb_reckoning::LengthBound;

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

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
