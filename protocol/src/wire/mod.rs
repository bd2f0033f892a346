//! Encoding of values as bytes and bits, and the errors of decoding.
//!
//! A value has one encoding: what decodes encodes to the same bytes, or is refused.

pub mod bits;
pub mod bytes;
pub(crate) mod range;

use core::fmt;

use rhumb_reckoning::InvalidMotion;

pub use bytes::{OPTIONAL, Wire};

/// The bytes do not encode a value of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Malformed {
    /// The bytes end too soon.
    Truncated,
    /// Bytes follow the end.
    Trailing,
    /// A number is not in its shortest form.
    NotCanonical,
    /// A number is outside its range.
    OutOfRange,
    /// A code without a meaning in any version so far.
    UnknownCode,
    /// A command that a later version may know: it is refused, and the rest of the message is valid.
    UnknownCommand,
    /// A number is NaN or infinite, or a rotation is not of unit length.
    NotFinite,
    /// The same for an exact motion.
    Motion(InvalidMotion),
    /// A text is not UTF-8 or contains forbidden characters.
    Text,
    /// A length or count exceeds its limit.
    TooLong,
}

impl fmt::Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Motion(invalid) => return invalid.fmt(f),
            Self::Truncated => "bytes end too soon",
            Self::Trailing => "bytes follow the end",
            Self::NotCanonical => "a number is not in its shortest form",
            Self::OutOfRange => "a number is out of range",
            Self::UnknownCode => "unknown code",
            Self::UnknownCommand => "unknown command",
            Self::NotFinite => "a number is not finite, or a rotation not of unit length",
            Self::Text => "text is not UTF-8 or holds forbidden characters",
            Self::TooLong => "longer than its limit",
        })
    }
}

impl core::error::Error for Malformed {}
