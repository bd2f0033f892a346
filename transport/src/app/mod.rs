//! TCP and UDP for clients of the paper's protocol.
//!
//! Understands nothing of what it carries. Every queue is bounded; connections that say nothing are ended.

mod connection;
mod datagram_queues;
mod datagram_sender;
mod endpoint;
mod io;
mod listener;
mod rate_limiter;

pub(crate) use connection::AppInput;
pub use endpoint::{AppEndpoint, AppTransmit};
pub use listener::{AppBindError, AppListen};
pub(crate) use listener::{AppHooks, AppListener};
