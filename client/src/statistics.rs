//! Statistics of a client's connection and stream.

use rhumb_protocol::stream::{PublisherStatistics, SubscriberStatistics};
use rhumb_reckoning::Tick;
use rhumb_transport::WireStatistics;

/// Statistics of a client's connection and stream.
#[derive(Clone, Copy, Debug)]
pub struct Statistics {
    /// Bytes, datagrams and round trip of the connection.
    pub wire: WireStatistics,
    /// Packets and updates received.
    pub stream: SubscriberStatistics,
    /// Packets and updates of the upstream since the last authority grant.
    pub upstream: PublisherStatistics,
    /// The newest tick up to which the subscriber knows that everything is published.
    pub watermark_tick: Tick,
    /// The newest tick at which every body is within its tolerance.
    pub complete: Tick,
    /// Ticks by which the view lies behind the server's clock; `None` before the clock is known.
    pub behind_ticks: Option<f64>,
}
