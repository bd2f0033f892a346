//! Counters of what a publisher has sent.
//!
//! Numbers only; no decision depends on them.

/// Counters of a publisher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates sent.
    pub updates: u64,
    /// Packets sent, without refreshes and watermarks.
    pub packets: u64,
    /// Bytes of these packets.
    pub bytes: u64,
    /// Observations compared with tracks. A body that stays asleep has none.
    pub checked: u64,
    /// Bodies out of tolerance without an update, because the budget did not suffice. Counted at every tick.
    pub over_budget: u64,
}
