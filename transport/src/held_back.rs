//! Control bytes that an endpoint does not want yet, in order for each peer.

use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::{Endpoint, Instant, Peer};

/// Control bytes of peers that wait until the endpoint wants them.
#[derive(Debug)]
pub struct HeldBack<T> {
    pieces: BTreeMap<Peer, VecDeque<T>>,
}

impl<T: AsRef<[u8]>> HeldBack<T> {
    /// Hands control bytes on, or holds them back.
    pub fn handle_control<E: Endpoint>(
        &mut self,
        now: Instant,
        endpoint: &mut E,
        from: Peer,
        piece: T,
    ) {
        if !self.pieces.contains_key(&from) && endpoint.wants_control(from) {
            endpoint.handle_control(now, from, piece.as_ref());
        } else {
            self.pieces.entry(from).or_default().push_back(piece);
        }
    }

    /// Hands on what is wanted now; returns whether there was any.
    pub fn deliver<E: Endpoint>(&mut self, now: Instant, endpoint: &mut E) -> bool {
        let mut any = false;
        self.pieces.retain(|peer, pieces| {
            while endpoint.wants_control(*peer)
                && let Some(piece) = pieces.pop_front()
            {
                endpoint.handle_control(now, *peer, piece.as_ref());
                any = true;
            }
            !pieces.is_empty()
        });
        any
    }

    /// Hands on all that is left of a peer whose connection has ended.
    pub fn deliver_rest<E: Endpoint>(&mut self, now: Instant, endpoint: &mut E, peer: Peer) {
        for piece in self.pieces.remove(&peer).into_iter().flatten() {
            endpoint.handle_control(now, peer, piece.as_ref());
        }
    }

    /// Drops what is left of a peer.
    pub fn forget(&mut self, peer: Peer) {
        self.pieces.remove(&peer);
    }
}

impl<T> Default for HeldBack<T> {
    fn default() -> Self {
        Self {
            pieces: BTreeMap::new(),
        }
    }
}
