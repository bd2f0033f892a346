//! Received bytes that wait for the server thread, and their bound.
//!
//! A piece holds its share of the bound until it is handled. The last pieces of a connection that has ended have none.
//! Control bytes that an endpoint does not accept yet are held back, in order for each peer.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::{Endpoint, Instant, Peer};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Cost of a waiting piece beside its bytes, so that empty datagrams are bounded too.
pub const PIECE_COST_BYTES: usize = 64;

/// Waiting bytes, with their share of the bound.
#[derive(Debug)]
pub struct Piece {
    /// The bytes.
    pub bytes: Bytes,
    _share: Option<OwnedSemaphorePermit>,
}

/// Bound on the bytes that wait on one lane of one connection.
#[derive(Clone, Debug)]
pub struct ByteCredit {
    bytes: Arc<Semaphore>,
}

impl ByteCredit {
    /// A bound of this number of bytes, the cost of pieces included.
    #[must_use]
    pub fn new(bytes: usize) -> Self {
        Self {
            bytes: Arc::new(Semaphore::new(bytes)),
        }
    }

    /// Waits until the bound allows the bytes.
    ///
    /// # Panics
    ///
    /// When the bytes are too many for one read.
    pub async fn admit(&self, bytes: &[u8]) -> Piece {
        let share = Arc::clone(&self.bytes)
            .acquire_many_owned(cost(bytes))
            .await
            .expect("the semaphore is never closed");
        Piece::new(bytes, Some(share))
    }

    /// `None` if the bound does not allow the bytes now.
    ///
    /// # Panics
    ///
    /// When the bytes are too many for one read.
    pub fn try_admit(&self, bytes: &[u8]) -> Option<Piece> {
        let share = Arc::clone(&self.bytes)
            .try_acquire_many_owned(cost(bytes))
            .ok()?;
        Some(Piece::new(bytes, Some(share)))
    }
}

impl Piece {
    /// Bytes that another bound limits.
    #[must_use]
    pub fn without_share(bytes: &[u8]) -> Self {
        Self::new(bytes, None)
    }

    /// Copies the bytes: they may be a sliver of a receive buffer of 64 KiB, which would then stay allocated
    /// uncounted.
    fn new(bytes: &[u8], share: Option<OwnedSemaphorePermit>) -> Self {
        Self {
            bytes: Bytes::copy_from_slice(bytes),
            _share: share,
        }
    }
}

impl AsRef<[u8]> for Piece {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

fn cost(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len() + PIECE_COST_BYTES).expect("a piece is at most a read's bytes")
}

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

    /// Drops the remaining bytes of a peer.
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
