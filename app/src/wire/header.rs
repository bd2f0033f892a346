//! The 24 bytes at the start of every message.

use super::codec::{Field, FieldReader};
use super::kind::Kind;
use super::malformed::MalformedMessage;

/// The only version.
const VERSION: u16 = 1;

/// Type and length of a message. Timestamp and reserved bytes are written as zero and not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// The message's type.
    pub(crate) kind: Kind,
    /// The sender's counter. It only serves to name a faulty message: it repeats and goes back.
    pub(crate) index: u32,
    /// Bytes of the message, header included.
    pub(crate) length: usize,
}

impl Header {
    /// Appends the header.
    pub(crate) fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&VERSION.to_be_bytes());
        to.extend_from_slice(&self.kind.code().to_be_bytes());
        self.index.put(to);
        (self.length as u32).put(to);
        [0_u32; 3].put(to);
    }

    /// Takes the header off the front.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] for another version, an unknown type, or a length that no message of the type has.
    pub(crate) fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let version = from.array().map(u16::from_be_bytes)?;
        let code = from.array().map(u16::from_be_bytes)?;
        let index = u32::take(from)?;
        let bytes = u32::take(from)?;
        from.array::<12>()?;
        if version != VERSION {
            return Err(MalformedMessage::Version(version));
        }
        let kind = Kind::from_code(code).ok_or(MalformedMessage::UnknownKind(code))?;
        let length = kind.check_length(bytes)?;
        Ok(Self {
            kind,
            index,
            length,
        })
    }
}
