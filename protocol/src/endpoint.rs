//! The one shape of both ends: what a driver, real or not, feeds and drains.
//!
//! Neither clock nor socket: moments and bytes are arguments. A driver may call `handle_*` in any order, then drains
//! `poll_transmit` until it is empty, then asks `poll_timeout` when to come back. It never waits inside a call.

use bytes::Bytes;

use crate::link::LinkReport;
use crate::time::Instant;

/// A connection, named by the driver; never used again after it closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Peer(pub u64);

/// Something to send.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transmit {
    /// Bytes for the connection's control stream: reliable, in order, cut anywhere.
    Control {
        /// To whom.
        to: Peer,
        /// The next bytes of the stream.
        bytes: Bytes,
    },
    /// One state datagram: it arrives whole, or not at all, or late.
    State {
        /// To whom.
        to: Peer,
        /// The whole datagram.
        bytes: Bytes,
    },
    /// Sends what came before on the control stream, then ends the connection.
    Close {
        /// Whom to leave.
        to: Peer,
        /// Why; see `CloseCode`.
        code: u32,
    },
}

/// How a connection ended, as its end saw it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The peer closed it and gave this code.
    Closed(u32),
    /// Nothing was heard for the idle time.
    TimedOut,
    /// The transport failed or refused.
    Broken,
}

/// The next moment at which an endpoint wants `handle_timeout`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// When.
    pub at: Instant,
    /// Why.
    pub reason: WakeReason,
}

/// What an endpoint waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WakeReason {
    /// The next tick of a free-running scene is due.
    Tick,
    /// A silent stream must be watermark_tick for.
    Watermark,
    /// Lost packets must be asked for, again.
    Refresh,
    /// The peer's clock must be asked again.
    Ping,
}

/// An end of conversations: a server's, with many peers, or a client's, with one.
pub trait Endpoint {
    /// A connection stands.
    fn handle_opened(&mut self, now: Instant, peer: Peer);

    /// The next bytes of a peer's control stream, cut anywhere.
    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// One state datagram.
    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// A connection is gone; nothing more comes from it or goes to it.
    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending);

    /// A moment that `poll_timeout` named has come.
    fn handle_timeout(&mut self, now: Instant);

    /// How a peer's link does: told some ten times a second while something is said to it, where the driver can tell.
    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        let _ = (now, peer, report);
    }

    /// The next thing to send, in order per peer and lane.
    fn poll_transmit(&mut self) -> Option<Transmit>;

    /// When to call `handle_timeout`.
    fn poll_timeout(&self) -> Option<Wake>;
}
