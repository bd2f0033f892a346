//! Why a connection is ended, as a number on the wire.

use core::fmt;

use crate::wire::Malformed;

/// The code with which one end closes the connection (PROTOCOL 3.4). Unknown ones are kept as they are; those from 0x100
/// on are the transport's own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CloseCode(pub u32);

impl CloseCode {
    /// Nothing is wrong; the client has finished.
    pub const DONE: Self = Self(0);
    /// Bytes on the control stream are not of the protocol.
    pub const MALFORMED: Self = Self(1);
    /// A message is not allowed in this state.
    pub const VIOLATION: Self = Self(2);
    /// The two ends have no version in common.
    pub const VERSION: Self = Self(3);
    /// A limit of the protocol was exceeded.
    pub const LIMIT: Self = Self(4);
    /// An extension must be known to go on, and is not.
    pub const EXTENSION: Self = Self(5);
}

impl From<Malformed> for CloseCode {
    fn from(_: Malformed) -> Self {
        Self::MALFORMED
    }
}

impl fmt::Display for CloseCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match *self {
            Self::DONE => "done",
            Self::MALFORMED => "bytes that are not of the protocol",
            Self::VIOLATION => "a message that is not allowed in this state",
            Self::VERSION => "no version in common",
            Self::LIMIT => "a limit of the protocol was exceeded",
            Self::EXTENSION => "an extension that must be known is not",
            Self(code) => return write!(f, "unknown close code {code}"),
        })
    }
}
