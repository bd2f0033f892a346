//! TCP and UDP for clients of the APP protocol.
//!
//! Interprets no bytes. Every queue is bounded; silent connections are ended.

mod datagram_sender;
mod listener;

pub use listener::{AppBindError, AppListen, AppListener};
