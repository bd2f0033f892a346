//! Why a connection is ended, as a number on the wire.

use core::fmt;

use crate::wire::Malformed;

/// The code with which one end closes the connection (PROTOCOL 3.4). Unknown ones are kept as they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CloseCode(pub u32);

impl CloseCode {
    /// Nothing is wrong; the client has finished.
    pub const DONE: Self = Self(0);
    /// The server is stopping.
    pub const GOING_AWAY: Self = Self(1);
    /// Bytes on the control stream are not of the protocol.
    pub const MALFORMED: Self = Self(2);
    /// A message is not allowed in this state.
    pub const VIOLATION: Self = Self(3);
    /// The two ends have no version in common.
    pub const VERSION: Self = Self(4);
    /// The peer does not read what it is sent.
    pub const TOO_SLOW: Self = Self(5);
    /// A limit of the protocol was exceeded.
    pub const LIMIT: Self = Self(6);
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
            Self::GOING_AWAY => "the server is stopping",
            Self::MALFORMED => "bytes that are not of the protocol",
            Self::VIOLATION => "a message that is not allowed in this state",
            Self::VERSION => "no version in common",
            Self::TOO_SLOW => "the peer does not read what it is sent",
            Self::LIMIT => "a limit of the protocol was exceeded",
            Self(code) => return write!(f, "unknown close code {code}"),
        })
    }
}
