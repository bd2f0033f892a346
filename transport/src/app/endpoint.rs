//! What an endpoint is that also speaks the paper's protocol.
//!
//! Its connections have peers of their own, told apart from the others by their highest bit.

use core::net::SocketAddr;

use bytes::Bytes;
use rhumb_protocol::{Endpoint, Instant, Peer};

/// An endpoint with a second listener: a byte stream for each client, and datagrams by address.
pub trait AppEndpoint: Endpoint {
    /// A connection stands.
    fn handle_app_opened(&mut self, now: Instant, peer: Peer, from: SocketAddr);

    /// So many bytes for a connection have not left yet, as far as they were polled. Told before its own bytes are handled,
    /// so that what newer words supersede need not be said to who cannot keep up.
    fn handle_app_waiting(&mut self, now: Instant, peer: Peer, bytes: usize);

    /// The next bytes of a connection, cut anywhere.
    fn handle_app_bytes(&mut self, now: Instant, from: Peer, bytes: &[u8]);

    /// A datagram, from anyone.
    fn handle_app_datagram(&mut self, now: Instant, from: SocketAddr, bytes: &[u8]);

    /// A connection is gone; nothing more comes from it or goes to it.
    fn handle_app_ended(&mut self, now: Instant, peer: Peer);

    /// The next thing to send.
    fn poll_app(&mut self) -> Option<AppTransmit>;
}

/// Something to send to a client of the paper's protocol.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AppTransmit {
    /// Bytes for a connection, written at once: whole messages, so that no read cuts one.
    Bytes {
        /// To whom.
        to: Peer,
        /// Whole messages.
        bytes: Bytes,
    },
    /// A datagram.
    Datagram {
        /// Where to.
        to: SocketAddr,
        /// The whole datagram.
        bytes: Bytes,
    },
    /// Sends what came before, then ends the connection.
    Close {
        /// Whom to leave.
        to: Peer,
    },
}
