//! A conditioner of links: delay, jitter, loss and rate on real datagrams.
//!
//! For views, tests and figures; a server uses it for nothing else. The link has neither socket nor clock, and its seed
//! decides everything; the relay carries real datagrams over such links.

mod config;
mod counts;
mod direction;
mod link;
mod probability;
mod relay;
mod rng;

pub use config::{LinkConfig, LinkConfigError};
pub use counts::{LinkCounts, Tally};
pub use direction::Direction;
pub use link::{Lane, Link};
pub use probability::Probability;
pub use relay::{RelayError, UdpRelay};
