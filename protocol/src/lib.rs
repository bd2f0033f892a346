//! The Rhumb protocol: messages, packets, and the sessions of both ends.
//!
//! No clock, no socket, no engine: both ends are state machines that a driver feeds and drains (see `Endpoint`).
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod capacity;
mod endpoint;
mod interner;
pub mod limits;
mod link;
pub mod message;
pub mod packet;
pub mod scene;
pub mod session;
pub mod stream;
mod time;
pub mod wire;

pub use endpoint::{Ending, Endpoint, Peer, Transmit, Wake, WakeReason};
pub use link::LinkReport;
pub use time::{Instant, Span};
