//! The suite's own ends of connections, which misbehave only on request.

mod client_process;
pub(super) mod datagram;
mod decoder;
mod host;
mod interceptor;
mod live_pair;
mod lossy_client;
mod raw_client;
mod setting;
mod stderr_tail;
mod stream_history;
mod tolerance_check;

pub use decoder::Decoder;
pub use host::RawServer;
pub use interceptor::{Delivery, Interceptor};
pub use live_pair::LivePair;
pub use lossy_client::{LaneAction, LossyClient};
pub use raw_client::RawClient;
pub use setting::Setting;
pub use tolerance_check::{compare, compare_recorded};
