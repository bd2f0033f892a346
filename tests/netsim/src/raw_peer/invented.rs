//! First datagrams of invented clients, from addresses of loopback.
//!
//! Each is a valid `Initial` packet with a connection id and keys of its own, so that a server cannot tell it from a
//! client's.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::time::Instant;

use quinn::crypto::rustls::QuicClientConfig;
use quinn_proto::{ClientConfig, Endpoint, EndpointConfig, EndpointEvent};
use rhumb_link::Trust;
use rhumb_link::trust::client_tls;

use super::config::{RawPeerConfig, RawPeerError};

/// Sends hellos of invented clients to a server.
pub struct InventedClients {
    endpoint: Endpoint,
    config: ClientConfig,
    server: SocketAddr,
    sent: u32,
}

impl InventedClients {
    /// Invented clients of a server on loopback.
    ///
    /// # Errors
    ///
    /// [`RawPeerError`] when the trust is unusable.
    pub fn new(server: SocketAddr, trust: &Trust) -> Result<Self, RawPeerError> {
        let tls = client_tls(trust).map_err(RawPeerError::Certificate)?;
        let mut tls = Arc::unwrap_or_clone(tls);
        tls.alpn_protocols = RawPeerConfig::default().alpn;
        let tls = QuicClientConfig::try_from(tls)
            .map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
        Ok(Self {
            endpoint: Endpoint::new(Arc::new(EndpointConfig::default()), None, false, None),
            config: ClientConfig::new(Arc::new(tls)),
            server,
            sent: 0,
        })
    }

    /// Sends the hello of another client, from an address that none had before: there are 7.8 million.
    ///
    /// # Errors
    ///
    /// [`RawPeerError`] when the hello cannot be made, or the system sends nothing from such an address.
    pub fn send(&mut self) -> Result<(), RawPeerError> {
        let now = Instant::now();
        let (config, server) = (self.config.clone(), self.server);
        let begun = self.endpoint.connect(now, config, server, "localhost");
        let (handle, mut connection) =
            begun.map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
        let mut hello = Vec::new();
        let made = connection.poll_transmit(now, 1, &mut hello);
        let bytes = made.map_or(0, |transmit| transmit.size);
        // The client is forgotten at once: nothing reads the answer.
        self.endpoint.handle_event(handle, EndpointEvent::drained());
        let [_, high, middle, low] = self.sent.to_be_bytes();
        let from = Ipv4Addr::new(127, 1 + high % 120, middle, low);
        self.sent += 1;
        let socket = UdpSocket::bind((from, 0)).map_err(RawPeerError::Host)?;
        let sent = socket.send_to(&hello[..bytes], server);
        sent.map(drop).map_err(RawPeerError::Host)
    }
}
