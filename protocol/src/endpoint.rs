//! Interface of both ends to a driver: moments, link reports, transmissions.
//!
//! Neither clock nor socket: moments and bytes are arguments, and the driver measures the link. A driver calls
//! `handle_*` in any order, drains `poll_transmit` until it is empty, then asks `poll_timeout` for the time of the
//! next call. No call blocks.

use core::fmt;
use core::ops::Add;

use bytes::Bytes;

/// A connection, numbered by the driver; not reused after it closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Peer(pub u64);

/// One transmission.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Transmit {
    /// Bytes for the connection's control stream: reliable, in order, cut at any place.
    Control {
        /// The receiver.
        to: Peer,
        /// The next bytes of the stream.
        bytes: Bytes,
    },
    /// One state datagram: it arrives whole, or not at all, or late.
    State {
        /// The receiver.
        to: Peer,
        /// The whole datagram.
        bytes: Bytes,
    },
    /// Sends the queued control bytes, then ends the connection.
    Close {
        /// The receiver.
        to: Peer,
        /// The reason; see `CloseCode`.
        code: u32,
    },
}

/// The end of a connection, as one endpoint observes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The peer closed it and gave this code.
    Closed(u32),
    /// No packet was received for the idle time.
    TimedOut,
    /// The transport failed or refused.
    Broken,
}

/// The next moment at which an endpoint needs `handle_timeout`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// The moment.
    pub at: Instant,
    /// The reason.
    pub reason: WakeReason,
}

/// Reason of a timeout.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WakeReason {
    /// The next tick of a free-running scene is due.
    Tick,
    /// A silent stream needs a watermark.
    Watermark,
    /// A NACK for lost packets is due, for the first time or again.
    Refresh,
    /// A ping of the peer's clock is due.
    Ping,
    /// Received messages wait for their turn.
    Input,
    /// A snapshot may be sent again.
    Snapshot,
    /// A peer that has not said hello, or a thread that does not answer, is looked after.
    Deadline,
}

/// One end of connections: a server's, with many peers, or a client's, with one.
pub trait Endpoint {
    /// A connection was opened.
    fn handle_opened(&mut self, now: Instant, peer: Peer);

    /// The next bytes of a peer's control stream, cut at any place.
    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// A state datagram.
    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// A connection has ended: no bytes come from it or go to it.
    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending);

    /// A moment that `poll_timeout` named has come.
    fn handle_timeout(&mut self, now: Instant);

    /// State of a peer's link: reported some ten times a second while data is sent, where the driver can measure it.
    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        let _ = (now, peer, report);
    }

    /// The link has taken this many more of the control bytes handed over for a peer.
    ///
    /// A driver that reports this calls it with zero after `handle_opened`; it is then handed only a window of control
    /// bytes beyond those that the link took.
    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        let _ = (now, peer, bytes);
    }

    /// True if the endpoint can use more control bytes of a peer now. A driver may hold them back otherwise, so that
    /// flow control slows the peer down.
    fn wants_control(&self, from: Peer) -> bool {
        let _ = from;
        true
    }

    /// The next transmission, in order per peer and lane.
    fn poll_transmit(&mut self) -> Option<Transmit>;

    /// The time at which to call `handle_timeout`.
    fn poll_timeout(&self) -> Option<Wake>;
}

impl<E: Endpoint + ?Sized> Endpoint for &mut E {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        (**self).handle_opened(now, peer);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        (**self).handle_control(now, from, bytes);
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        (**self).handle_datagram(now, from, bytes);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        (**self).handle_ended(now, peer, ending);
    }

    fn handle_timeout(&mut self, now: Instant) {
        (**self).handle_timeout(now);
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        (**self).handle_link(now, peer, report);
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        (**self).handle_control_taken(now, peer, bytes);
    }

    fn wants_control(&self, from: Peer) -> bool {
        (**self).wants_control(from)
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        (**self).poll_transmit()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        (**self).poll_timeout()
    }
}

/// State of a link since the last report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkReport {
    /// Bytes handed over that have not left this end yet.
    pub waiting_bytes: u64,
    /// Bytes that left this end.
    pub sent_bytes: u64,
    /// Length of the measurement.
    pub over: Span,
    /// Last measured round trip to the peer, without the time in `waiting_bytes`.
    pub round_trip: Span,
}

/// A moment of one machine's monotonic clock, in nanoseconds since the clock's own zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Instant {
    ns: u64,
}

/// A span of wall-clock time in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Span {
    ns: u64,
}

impl Instant {
    /// The zero of the clock.
    pub const ZERO: Self = Self { ns: 0 };

    /// The moment `ns` nanoseconds after zero.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// Nanoseconds since zero.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.ns
    }

    /// The time since `earlier`, or zero if that is later.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Span {
        Span {
            ns: self.ns.saturating_sub(earlier.ns),
        }
    }
}

impl Add<Span> for Instant {
    type Output = Self;

    fn add(self, span: Span) -> Self {
        Self {
            ns: self.ns.saturating_add(span.ns),
        }
    }
}

impl Span {
    /// No time.
    pub const ZERO: Self = Self { ns: 0 };

    /// A span of nanoseconds.
    #[must_use]
    pub const fn from_nanos(ns: u64) -> Self {
        Self { ns }
    }

    /// A span of milliseconds; the longest span, 584 years, for more than it has.
    #[must_use]
    pub const fn from_millis(ms: u64) -> Self {
        Self {
            ns: ms.saturating_mul(1_000_000),
        }
    }

    /// Nanoseconds.
    #[must_use]
    pub const fn as_nanos(self) -> u64 {
        self.ns
    }
}

impl fmt::Display for Span {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let micros = self.ns / 1_000;
        write!(f, "{}.{:03} ms", micros / 1_000, micros % 1_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_and_moments_beyond_what_they_hold_are_the_last_ones() {
        let longest = Span::from_nanos(u64::MAX);
        for ms in [18_446_744_073_710, 253_402_300_800_000, u64::MAX] {
            assert_eq!(Span::from_millis(ms), longest);
        }
        let span = Span::from_millis(18_446_744_073_709);
        assert!(span < longest);
        assert_eq!(
            Instant::from_nanos(7) + longest,
            Instant::from_nanos(u64::MAX)
        );
    }
}
