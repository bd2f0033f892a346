//! The 24 bytes that every message begins with.

use alloc::vec::Vec;

use crate::kind::Kind;
use crate::malformed::Malformed;
use crate::wire::{Field, Reader};

/// Bytes of a header.
pub const HEADER_BYTES: usize = 24;

/// The only version there is.
const VERSION: u16 = 1;

/// What a message is, and how long. Timestamp and reserved bytes are nobody's: written as zero, not looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Its type.
    pub kind: Kind,
    /// A counter of its sender's, of use for naming a message at fault and for nothing else: it repeats and goes back.
    pub index: u32,
    /// Bytes of the message, header included.
    pub length: usize,
}

impl Header {
    /// Appends it.
    pub(crate) fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&VERSION.to_be_bytes());
        to.extend_from_slice(&self.kind.code().to_be_bytes());
        self.index.put(to);
        (self.length as u32).put(to);
        [0_u32; 3].put(to);
    }

    /// Reads it off the front.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for another version, an unknown type, or a length that no message of the type has.
    pub(crate) fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let version = from.array().map(u16::from_be_bytes)?;
        let code = from.array().map(u16::from_be_bytes)?;
        let index = u32::take(from)?;
        let bytes = u32::take(from)?;
        from.array::<12>()?;
        if version != VERSION {
            return Err(Malformed::Version(version));
        }
        let kind = Kind::from_code(code).ok_or(Malformed::UnknownKind(code))?;
        let length = kind.check_length(bytes)?;
        Ok(Self {
            kind,
            index,
            length,
        })
    }
}
