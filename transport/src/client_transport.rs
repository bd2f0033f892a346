//! A client's connection to its server, whatever carries the bytes.

use std::time::Duration;

use bytes::Bytes;

use crate::quic::{Received, WireStatistics};

/// An open connection of a client: one reliable stream of control bytes, and state datagrams.
///
/// [`QuicClient`](crate::QuicClient) reaches a server over the network. Other programs may bring their own.
pub trait ClientTransport: Send {
    /// Appends bytes to the control stream without waiting. A connection that cannot keep them ends.
    fn send_control(&self, bytes: Bytes);

    /// Sends one datagram without waiting. It arrives whole, or not at all.
    fn send_state(&self, bytes: Bytes);

    /// Ends the connection with a code, once the control bytes have arrived or after a short wait.
    fn close(&self, code: u32);

    /// The next received item, within `timeout`; zero does not wait.
    ///
    /// [`Received::Ended`] comes once, after everything else; from then on this returns `None` at once.
    fn recv(&mut self, timeout: Duration) -> Option<Received>;

    /// The connection's traffic so far.
    fn statistics(&self) -> WireStatistics;
}
