//! QUIC on loopback and Unix sockets, end to end: the promises of both ends.
//!
//! Real sockets and threads; every wait is for an event, and a time limit only bounds a failure. Proves delivery, not
//! timing.

mod closing;
mod connecting;
mod lanes;
mod support;
#[cfg(unix)]
mod unix;
mod web;
mod web_http3;
