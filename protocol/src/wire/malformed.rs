//! Why bytes are not a value.

use core::fmt;

use rhumb_reckoning::InvalidMotion;

/// The bytes are not a value of the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Malformed {
    /// They end too soon.
    Truncated,
    /// Something follows the end.
    Trailing,
    /// A number was not said in its one shortest form.
    NotCanonical,
    /// A number lies outside its range.
    OutOfRange,
    /// A code that no version so far has given a meaning.
    UnknownCode,
    /// A command that a later version may know: it is refused, and nothing else is wrong.
    UnknownCommand,
    /// A number is NaN or infinite, or a rotation is not of unit length.
    NotFinite,
    /// So it is with a motion that was said to the bit.
    Motion(InvalidMotion),
    /// A text is not UTF-8 or holds characters that it may not.
    Text,
    /// More than a limit allows.
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
