//! QUIC ends without parameters_list, for who tries others: they do as they are told.
//!
//! No part of a session: nothing is bounded but by how long a trial lasts, nothing is refreshed, and every end that is
//! events is told as it was events. What a connection says and hears is the caller's matter, down to its streams.

mod client;
mod config;
mod connection;
mod server;

pub use config::{RawPeerConfig, RawPeerError};
pub use connection::{RawConnection, RawEvent, RawPeerEnd};
pub use server::RawPeerServer;
