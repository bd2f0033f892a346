//! How the connection and the stream are doing.

use rhumb_protocol::stream::{PublisherStatistics, SubscriberStatistics};
use rhumb_reckoning::Tick;
use rhumb_transport::WireStatistics;

/// How the connection and the stream are doing.
#[derive(Clone, Copy, Debug)]
pub struct Statistics {
    /// Bytes, datagrams and round trip of the connection.
    pub wire: WireStatistics,
    /// Packets and updates received.
    pub stream: SubscriberStatistics,
    /// Packets and updates of the upstream, since its bodies were granted.
    pub driven: PublisherStatistics,
    /// The newest tick up to which the stream has published everything.
    pub watermark_tick: Tick,
    /// The newest tick at which every body is within its tolerance.
    pub complete: Tick,
    /// How many ticks the view lies behind the server's clock, where that is known.
    pub behind_ticks: Option<f64>,
}
