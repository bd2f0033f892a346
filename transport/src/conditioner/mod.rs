//! A conditioner of links: delay, jitter, loss and rate on real datagrams.
//!
//! For views, tests and figures; a server uses it for nothing else. The link has neither socket nor clock, and its seed
//! decides everything; the relay carries real datagrams over such links.

mod config;
mod link;
mod relay;

pub use config::{LinkConfig, LinkConfigError, Probability};
pub use link::{Lane, Link, LinkCounts, Tally};
pub use relay::{Direction, RelayError, UdpRelay};
