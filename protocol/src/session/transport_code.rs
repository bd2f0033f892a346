//! Close codes of the transport, above those of the protocol.
//!
//! Only the names of numbers: the transport decides when to close with them.

use core::fmt;

/// A close code of the transport (PROTOCOL 3.4).
///
/// Codes from 0x100 on belong to the transport, those below to the protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TransportCode(pub u32);

impl TransportCode {
    /// The least of these codes.
    pub const FIRST: u32 = 0x100;
    /// The end left without a reason.
    pub const LEFT: Self = Self(0x100);
    /// The server is stopping; another attempt later may find it again.
    pub const GOING_AWAY: Self = Self(0x101);
    /// More control bytes wait for this peer than the bound allows: the peer reads too slowly.
    pub const CONTROL_OVERFLOW: Self = Self(0x102);
    /// The client opened no control stream in time, or broke it.
    pub const NO_CONTROL_STREAM: Self = Self(0x103);
    /// The peer's datagrams are disabled or too small for the protocol.
    pub const NO_DATAGRAMS: Self = Self(0x104);
}

impl fmt::Display for TransportCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::LEFT => f.write_str("left"),
            Self::GOING_AWAY => f.write_str("server going away"),
            Self::CONTROL_OVERFLOW => f.write_str("control lane too slow"),
            Self::NO_CONTROL_STREAM => f.write_str("no control stream"),
            Self::NO_DATAGRAMS => f.write_str("datagrams absent or too small"),
            Self(code) => write!(f, "close code {code:#x}"),
        }
    }
}
