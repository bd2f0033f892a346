//! Unix stream sockets for both ends: the network's packets on one machine.
//!
//! Control and state share the stream, in frames. No bytes are interpreted here. A client reads on its caller's thread;
//! a server has a thread for the socket, and two for each connection, whose queues are bounded.

mod client;
mod frame;
mod server;

pub use client::UnixClient;
pub use server::{UnixServer, WithUnixPeers};
