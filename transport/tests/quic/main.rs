//! QUIC end to end on loopback: what both ends promise their callers.
//!
//! Real sockets and threads; every wait is for an event, and a patience only bounds a failure. Proves carrying, not timing.

mod closing;
mod connecting;
mod lanes;
mod raw_peer;
mod support;
