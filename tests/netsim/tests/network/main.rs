//! The simulated network, its relay and its raw peers.

mod link;
mod raw_peer;
mod relay;
mod sim_network;
