//! What names a connection in each packet, as short as it may be.
//!
//! Packets to a client need no name: one socket has one connection. Packets to a server need one, so that a connection
//! outlives a change of address; guessing one gains nothing, since every packet is authenticated.

use std::sync::Arc;
use std::time::Duration;

use quinn::rustls::crypto::CryptoProvider;
use quinn::{ConnectionId, ConnectionIdGenerator};

/// Bytes of the names that a server gives: with some 5,000 in use at most, one draw in a million is drawn again.
pub(super) const SERVER_ID_BYTES: usize = 4;

/// Names no connection: packets are told apart by address alone.
pub(super) struct Unnamed;

/// Names connections by chance.
pub(super) struct Short {
    provider: Arc<CryptoProvider>,
}

impl Short {
    /// Chance is the provider's.
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
