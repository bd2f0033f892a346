//! Why bytes are not a message.

use core::fmt;

/// Bytes that nobody who speaks the protocol says. Nothing behind them can be read either.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Malformed {
    /// They end too soon.
    Truncated,
    /// They go on behind the end.
    TrailingBytes,
    /// Another version.
    Version(u16),
    /// A type that there is not.
    UnknownKind(u16),
    /// A length that no message of this type has.
    Length {
        /// The type, as said.
        kind: u16,
        /// The length, as said.
        bytes: u32,
    },
    /// More points, triangles or posts than allowed, or than the length has room for.
    Count(u32),
    /// A text that is not UTF-8.
    Text,
}

impl fmt::Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the message ends too soon"),
            Self::TrailingBytes => f.write_str("the message goes on behind its end"),
            Self::Version(version) => write!(f, "version {version} is not spoken here"),
            Self::UnknownKind(kind) => write!(f, "there is no message of type {kind}"),
            Self::Length { kind, bytes } => {
                write!(f, "no message of type {kind} is {bytes} bytes long")
            }
            Self::Count(count) => write!(f, "a count of {count} does not fit the message"),
            Self::Text => f.write_str("a text is not UTF-8"),
        }
    }
}

impl core::error::Error for Malformed {}
