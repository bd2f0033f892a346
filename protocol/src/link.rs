//! How a connection's link does, as its driver sees it.
//!
//! Measured by whoever owns the sockets, or by the simulated network; what follows from it is the endpoint's matter.

use crate::time::Span;

/// How a link did since the report before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkReport {
    /// Bytes handed over that have not left this end yet.
    pub waiting_bytes: u64,
    /// Bytes that left.
    pub sent_bytes: u64,
    /// In what time.
    pub over: Span,
    /// From here to the peer and back, as last measured; time in `waiting_bytes` aside.
    pub round_trip: Span,
}
