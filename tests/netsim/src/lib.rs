//! A simulated network, and raw QUIC peers.
//!
//! For tests and benches only. The simulated network has no socket, no clock and no thread: one seed and one order of
//! calls give one run, to the bit. Its links are those of the transport's conditioner. A raw peer sends the bytes that
//! its caller gives it, valid or not.
#![forbid(unsafe_code)]

mod raw_peer;
mod sim_network;

pub use raw_peer::{
    Carrier, InventedClients, RawConnection, RawEvent, RawPeerConfig, RawPeerEnd, RawPeerError,
    RawPeerServer,
};
pub use rhumb_transport::conditioner::{
    Direction, Lane, Link, LinkConfig, LinkConfigError, LinkCounts, Probability, RelayError, Tally,
    UdpRelay,
};
pub use sim_network::{RunStop, SimNetwork};
