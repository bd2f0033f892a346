//! TCP and UDP for clients of the APP protocol.
//!
//! Interprets no bytes. Every queue is bounded; silent connections are ended.

mod connection;
mod datagram_pace;
mod datagram_queues;
mod datagram_sender;
mod io;
mod listener;
mod rate_limiter;

pub use listener::{AppBindError, AppListen, AppListener};
