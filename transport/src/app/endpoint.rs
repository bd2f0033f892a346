//! Endpoint that also serves clients of the APP protocol.
//!
//! APP connections have their own peer numbers, with the highest bit set.

use core::net::SocketAddr;

use bytes::Bytes;
use rhumb_protocol::{Endpoint, Instant, Peer};

/// An endpoint with a second listener: a byte stream for each client, and datagrams by address.
pub trait AppEndpoint: Endpoint {
    /// A connection was opened.
    fn handle_app_opened(&mut self, now: Instant, peer: Peer, from: SocketAddr);

    /// Cost of the queued bytes of a connection. Called before the connection's own bytes are handled, so that a slow
    /// client is not sent updates that newer ones supersede.
    fn handle_app_waiting(&mut self, now: Instant, peer: Peer, bytes: usize);

    /// The next bytes of a connection, cut at any place.
    fn handle_app_bytes(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// A datagram from any address.
    fn handle_app_datagram(&mut self, now: Instant, from: SocketAddr, bytes: &[u8]);

    /// A connection has ended; no bytes come from it or go to it any more.
    fn handle_app_ended(&mut self, now: Instant, peer: Peer);

    /// The next transmission.
    fn poll_app(&mut self) -> Option<AppTransmit>;
}

/// A transmission to an APP client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AppTransmit {
    /// Bytes for a connection, written at once: whole messages, so that no read cuts one.
    Bytes {
        /// The connection.
        to: Peer,
        /// Whole messages.
        bytes: Bytes,
    },
    /// A datagram.
    Datagram {
        /// The destination.
        to: SocketAddr,
        /// The whole datagram.
        bytes: Bytes,
    },
    /// Sends the queued bytes, then ends the connection.
    Close {
        /// The connection.
        to: Peer,
    },
}
