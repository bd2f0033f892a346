//! Raw QUIC peers, which send the exact bytes of a test.
//!
//! A raw peer has no session and no limits, and repairs nothing. It reports every end as observed. The caller decides
//! all content of a connection, down to its streams.

mod client;
mod config;
mod connection;
mod invented;
mod server;

pub use config::{Carrier, RawPeerConfig, RawPeerError};
pub use connection::{RawConnection, RawEvent, RawPeerEnd};
pub use invented::InventedClients;
pub use server::RawPeerServer;
