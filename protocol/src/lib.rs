//! The Rhumb protocol: messages, packets, and the sessions of both ends.
//!
//! No clock, no socket, no engine: both ends are state machines that a driver feeds and drains (see `Endpoint`).
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod endpoint;
mod interner;
pub mod limits;
pub mod message;
pub mod packet;
pub mod scene;
pub mod session;
pub mod stream;
pub mod wire;

pub use endpoint::{Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason};
