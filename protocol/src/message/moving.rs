//! That a member is moved to another tier for its link, and whether it may be
//!
//! Who decides that a link is thin, and when, is the server's matter.

use rhumb_reckoning::LengthBound;

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Why a server moved a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MoveCause {
    /// The link did not carry the stream.
    Thin,
    /// The link has carried the coarser stream with ease for so long that the finer one is tried again.
    Eased,
}

impl Wire for MoveCause {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::Thin => 0,
            Self::Eased => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Thin),
            1 => Ok(Self::Eased),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// Where a server may move a member whose link is thin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Moves {
    /// Nowhere: late and lossy is better than coarse.
    Never,
    /// To tiers as coarse as this.
    UpTo(LengthBound),
}

impl Wire for Moves {
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
    fn what_may_be_done_comes_back_and_what_may_not_is_refused() {
        let coarse = LengthBound::from_micrometres(200_000).unwrap();
        for (moves, bytes) in [
            (Moves::Never, &[0][..]),
            (Moves::UpTo(coarse), &[1, 0xc0, 0x9a, 0x0c][..]),
        ] {
            let mut writer = Writer::new();
            moves.encode(&mut writer);
            assert_eq!(writer.into_bytes(), bytes);
            assert_eq!(Moves::decode(&mut Reader::new(bytes)), Ok(moves));
        }
        let refused = |bytes: &[u8]| Moves::decode(&mut Reader::new(bytes)).unwrap_err();
        assert_eq!(refused(&[1, 1]), Malformed::OutOfRange);
        assert_eq!(refused(&[2]), Malformed::UnknownCode);
        let unknown = MoveCause::decode(&mut Reader::new(&[2]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
    }
}
