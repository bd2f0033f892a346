//! Traffic on the wire, below the protocol's messages.
//!
//! Counts UDP payloads, without the headers of UDP and IP (28 or 48 bytes a datagram).

use std::ops::AddAssign;
use std::time::Duration;

/// Traffic of one connection since it began, in UDP payloads; or the sum over several.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WireStatistics {
    /// UDP payload bytes sent.
    pub sent_bytes: u64,
    /// UDP datagrams sent.
    pub sent_datagrams: u64,
    /// UDP payload bytes received.
    pub received_bytes: u64,
    /// UDP datagrams received.
    pub received_datagrams: u64,
    /// QUIC packets that this end sent and considers lost.
    pub lost_packets: u64,
    /// Round-trip time as QUIC estimates it now; in a sum, the greatest.
    pub round_trip: Duration,
}

/// Counters of a server over its whole life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServerStatistics {
    /// Connections that were opened.
    pub opened: u64,
    /// Connections that have ended.
    pub ended: u64,
    /// Attempts refused because the server was full.
    pub refused: u64,
    /// Connections closed because their peer read control bytes too slowly.
    pub control_overflows: u64,
    /// Datagrams from clients dropped because the server thread was late.
    pub state_dropped: u64,
    /// Datagrams to clients that were larger than the path allows.
    pub state_oversized: u64,
}

impl WireStatistics {
    pub(super) fn of(connection: &quinn::Connection) -> Self {
        let stats = connection.stats();
        Self {
            sent_bytes: stats.udp_tx.bytes,
            sent_datagrams: stats.udp_tx.datagrams,
            received_bytes: stats.udp_rx.bytes,
            received_datagrams: stats.udp_rx.datagrams,
            lost_packets: stats.path.lost_packets,
            round_trip: stats.path.rtt,
        }
    }
}

impl AddAssign for WireStatistics {
    fn add_assign(&mut self, other: Self) {
        self.sent_bytes += other.sent_bytes;
        self.sent_datagrams += other.sent_datagrams;
        self.received_bytes += other.received_bytes;
        self.received_datagrams += other.received_datagrams;
        self.lost_packets += other.lost_packets;
        self.round_trip = self.round_trip.max(other.round_trip);
    }
}
