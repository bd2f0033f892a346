//! Reasons why bytes are not a message.

use core::fmt;

/// Bytes that do not follow the protocol. Nothing after them can be decoded either.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MalformedMessage {
    /// The bytes end too soon.
    Truncated,
    /// The bytes continue after the end of the message.
    TrailingBytes,
    /// An unknown version.
    Version(u16),
    /// An unknown type.
    UnknownKind(u16),
    /// A length that no message of this type has.
    Length {
        /// The type in the header.
        kind: u16,
        /// The length in the header.
        bytes: u32,
    },
    /// More points, triangles or posts than allowed, or than the length provides bytes for.
    Count(u32),
    /// A text that is not UTF-8.
    Text,
}

impl fmt::Display for MalformedMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the message ends too soon"),
            Self::TrailingBytes => f.write_str("bytes follow the end of the message"),
            Self::Version(version) => write!(f, "version {version} is not supported"),
            Self::UnknownKind(kind) => write!(f, "there is no message of type {kind}"),
            Self::Length { kind, bytes } => {
                write!(f, "no message of type {kind} is {bytes} bytes long")
            }
            Self::Count(count) => write!(f, "a count of {count} does not fit the message"),
            Self::Text => f.write_str("a text is not UTF-8"),
        }
    }
}

impl core::error::Error for MalformedMessage {}
