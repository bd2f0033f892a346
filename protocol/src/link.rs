//! Report on a connection's link by its driver.
//!
//! The owner of the sockets, or the simulated network, measures; the endpoint decides what follows.

use crate::time::Span;

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
