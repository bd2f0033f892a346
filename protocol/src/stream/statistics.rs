//! Counters of what a subscriber has received.
//!
//! Numbers only; no decision depends on them.

/// Counters of a subscriber.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriberStatistics {
    /// Packets that arrived after a packet that was sent later.
    pub disordered: u64,
    /// Packets of this stream that were read, recovered ones included.
    pub packets: u64,
    /// Updates applied.
    pub updates: u64,
    /// Datagrams received twice.
    pub duplicates: u64,
    /// Datagrams that are malformed.
    pub malformed: u64,
    /// Packets found missing.
    pub missed: u64,
    /// Repair symbols received.
    pub repair_symbols: u64,
    /// Packets recovered from repair symbols.
    pub rebuilt: u64,
    /// Parts of refreshes applied.
    pub refreshes: u64,
    /// Updates that built on a missing packet.
    pub unread: u64,
    /// Packets dropped because too many waited for scene events.
    pub overflowed: u64,
    /// Checksums compared with the publisher's.
    pub compared: u64,
    /// Mismatches among them: a fault of the publisher or of the subscriber. A new snapshot follows.
    pub mismatches: u64,
}
