//! What a subscriber heard so far, counted.
//!
//! Numbers only; nothing is decided by them here.

/// What a subscriber heard so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriberStatistics {
    /// Packets that came by themselves behind ones that were sent later.
    pub disordered: u64,
    /// Packets of this stream that were read, rebuilt ones too.
    pub packets: u64,
    /// Updates taken in.
    pub updates: u64,
    /// Datagrams that came twice.
    pub duplicates: u64,
    /// Datagrams that are not of the protocol.
    pub malformed: u64,
    /// Packets found missing.
    pub missed: u64,
    /// FecEncoder heard.
    pub repair_symbols: u64,
    /// Packets that repair_symbols gave back.
    pub rebuilt: u64,
    /// Repairs taken in, in parts.
    pub refreshes: u64,
    /// Updates that built on a missing one.
    pub unread: u64,
    /// Packets dropped because too many waited for scene_events.
    pub overflowed: u64,
    /// Sums over tracks that were compared with the publisher's.
    pub compared: u64,
    /// Of these, the mismatches: a fault of the publisher or of the subscriber. A new snapshot follows.
    pub mismatches: u64,
}
