//! A transmission to an APP client.

use core::net::SocketAddr;

use bytes::Bytes;
use rhumb_protocol::Peer;

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
