//! Connection ids, as short as possible.
//!
//! Packets to a client need no id: one socket has one connection. Packets to a server need one, so that a connection
//! survives a change of address. Guessing an id gains nothing, since every packet is authenticated.

use std::sync::Arc;
use std::time::Duration;

use quinn::rustls::crypto::CryptoProvider;
use quinn::{ConnectionId, ConnectionIdGenerator};

/// Bytes of a server's ids: with some 5,000 in use at most, one draw in a million is repeated.
pub(super) const SERVER_ID_BYTES: usize = 4;

/// Generates empty ids: the address alone identifies the connection.
pub(super) struct Unnamed;

/// Generates random ids.
pub(super) struct Short {
    provider: Arc<CryptoProvider>,
}

impl Short {
    /// Uses the provider's random numbers.
    pub(super) const fn new(provider: Arc<CryptoProvider>) -> Self {
        Self { provider }
    }
}

impl ConnectionIdGenerator for Unnamed {
    fn generate_cid(&mut self) -> ConnectionId {
        ConnectionId::new(&[])
    }

    fn cid_len(&self) -> usize {
        0
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}

impl ConnectionIdGenerator for Short {
    fn generate_cid(&mut self) -> ConnectionId {
        let mut bytes = [0; SERVER_ID_BYTES];
        let filled = self.provider.secure_random.fill(&mut bytes);
        filled.expect("a system that made a TLS key has random numbers");
        ConnectionId::new(&bytes)
    }

    fn cid_len(&self) -> usize {
        SERVER_ID_BYTES
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}
