//! A network that exists only in memory, the same each time.
//!
//! No socket, no clock, no thread: the same seed and the same calls give the same run, to the bit.

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
