//! The cause of a member's request for a new snapshot.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The cause of a member's request for a new snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResyncCause {
    /// So many packets are missing that no refresh helps.
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
