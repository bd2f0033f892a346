//! Why a member asks for a snapshot again.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Why a member asks for a snapshot again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResyncCause {
    /// It lost so much that no refresh helps.
    LostSync,
    /// A checksum of the stream's is another than that of its tracks: a fault of one of the two ends.
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
