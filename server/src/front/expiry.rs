//! When the permits of connections end.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::{Instant, Peer};

/// The connections whose permits end, in order of their ends.
#[derive(Debug, Default)]
pub(super) struct Expiry {
    by_time: BTreeSet<(Instant, Peer)>,
    ends: BTreeMap<Peer, Instant>,
}

impl Expiry {
    pub(super) fn set(&mut self, peer: Peer, at: Instant) {
        self.ends.insert(peer, at);
        self.by_time.insert((at, peer));
    }

    pub(super) fn forget(&mut self, peer: Peer) {
        if let Some(at) = self.ends.remove(&peer) {
            self.by_time.remove(&(at, peer));
        }
    }

    /// When the next permit ends.
    pub(super) fn next(&self) -> Option<Instant> {
        self.by_time.first().map(|(at, _)| *at)
    }

    /// Takes a connection whose permit has ended.
    pub(super) fn pop(&mut self, now: Instant) -> Option<Peer> {
        let (_, peer) = *self.by_time.first().filter(|(at, _)| *at <= now)?;
        self.forget(peer);
        Some(peer)
    }
}
