//! A simulated network, a relay with a simulated link, and raw QUIC peers.
//!
//! For tests and benches only. The simulated network has no socket, no clock and no thread: one seed and one order of
//! calls give one run, to the bit. The relay carries real datagrams over such a link. A raw peer sends the bytes that
//! its caller gives it, valid or not.
#![forbid(unsafe_code)]

mod config;
mod counts;
mod link;
mod probability;
mod raw_peer;
mod relay;
mod rng;
mod sim_network;

pub use config::{LinkConfig, LinkConfigError};
pub use counts::{LinkCounts, Tally};
pub use link::{Lane, Link};
pub use probability::Probability;
pub use raw_peer::{
    Carrier, RawConnection, RawEvent, RawPeerConfig, RawPeerEnd, RawPeerError, RawPeerServer,
};
pub use relay::{RelayError, UdpRelay};
pub use sim_network::{Direction, RunStop, SimNetwork};
