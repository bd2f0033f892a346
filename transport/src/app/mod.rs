//! TCP and UDP for clients of the APP protocol.
//!
//! Interprets no bytes. Every queue is bounded; silent connections are ended.

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
