//! A simulated network in memory, the same in each run.
//!
//! No socket, clock or thread: equal seeds and calls give equal runs, to the bit.

mod config;
mod counts;
mod link;
mod probability;
mod rng;
mod sim_network;

pub use config::{LinkConfig, LinkConfigError};
pub use counts::{LinkCounts, Tally};
pub use link::{Lane, Link};
pub use probability::Probability;
pub use sim_network::{Direction, RunStop, SimNetwork};
