//! A transmission to an APP client.

use core::net::SocketAddr;

use bytes::Bytes;
use rhumb_protocol::Peer;

use super::subject::{DatagramSubject, Urgency};

/// A datagram to an APP client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AppDatagram {
    /// The destination.
    pub to: SocketAddr,
    /// The whole datagram.
    pub bytes: Bytes,
    /// While it waits, a newer one about the same subject takes its place; `None`: none does.
    pub subject: Option<DatagramSubject>,
    /// The most urgent one leaves first.
    pub urgency: Urgency,
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
    Datagram(AppDatagram),
    /// Sends the queued bytes, then ends the connection.
    Close {
        /// The connection.
        to: Peer,
    },
}
