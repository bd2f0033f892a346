//! The close code: the reason for the end of a connection, as a number.

use core::fmt;

use crate::wire::Malformed;

/// The code with which one end closes the connection (PROTOCOL 3.4).
///
/// An unknown code is kept as it is. Codes from 0x100 on belong to the transport.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CloseCode(pub u32);

impl CloseCode {
    /// Nothing is wrong; the client has finished.
    pub const DONE: Self = Self(0);
    /// Bytes on the control stream do not follow the protocol.
    pub const MALFORMED: Self = Self(1);
    /// A message is not allowed in this state.
    pub const VIOLATION: Self = Self(2);
    /// The two ends have no version in common.
    pub const VERSION: Self = Self(3);
    /// A limit of the protocol was exceeded.
    pub const LIMIT: Self = Self(4);
    /// A critical extension is unknown.
    pub const EXTENSION: Self = Self(5);
    /// The scene does not answer and is parked: it is lost, and its name is free again when its step has ended.
    pub const SCENE_PARKED: Self = Self(6);
    /// The server, or a scene that a client comes back to, has no place now.
    pub const BUSY: Self = Self(7);
    /// The client sent no `Hello` in time.
    pub const HELLO_LATE: Self = Self(8);
    /// The process of the scene has ended, and the scene is restored from what is durable: a later attempt finds it.
    pub const SCENE_RESTORING: Self = Self(9);
    /// The process of the scene has ended, and nothing of the scene was durable: it is lost, and its name is free.
    pub const SCENE_LOST: Self = Self(10);
    /// The server requires a token, and the client's hello has none.
    pub const TOKEN_MISSING: Self = Self(16);
    /// The token is not one of this server: its form, its signature or its audience is wrong.
    pub const TOKEN_INVALID: Self = Self(17);
    /// The token has expired.
    pub const TOKEN_EXPIRED: Self = Self(18);
    /// The token does not name the scene of the connection.
    pub const TOKEN_SCENE: Self = Self(19);
    /// Another connection has taken the session up.
    pub const SESSION_TAKEN: Self = Self(32);
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
            Self::SCENE_PARKED => "the scene does not answer and is parked",
            Self::BUSY => "there is no place now; a later attempt may find one",
            Self::HELLO_LATE => "no hello in time",
            Self::SCENE_RESTORING => "the scene is restored after its process ended",
            Self::SCENE_LOST => "the scene is lost with its process",
            Self::TOKEN_MISSING => "the server requires a token",
            Self::TOKEN_INVALID => "the token is not one of this server",
            Self::TOKEN_EXPIRED => "the token has expired",
            Self::TOKEN_SCENE => "the token does not name the scene",
            Self::SESSION_TAKEN => "another connection has taken the session up",
            Self(code) => return write!(f, "unknown close code {code}"),
        })
    }
}
