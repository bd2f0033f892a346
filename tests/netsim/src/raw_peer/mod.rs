//! Raw QUIC peers: they send whatever a test tells them to.
//!
//! No session. Nothing is bounded except the duration of a test, nothing is repaired, and every end is reported as
//! observed. The caller decides all content of a connection, down to its streams.

mod client;
mod config;
mod connection;
mod server;

pub use config::{RawPeerConfig, RawPeerError};
pub use connection::{RawConnection, RawEvent, RawPeerEnd};
pub use server::RawPeerServer;
