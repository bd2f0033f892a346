//! Bytes that wait for the host thread, and how many may.
//!
//! Decides nothing. A piece holds its share of a bound until it was handled.

use std::sync::Arc;

use bytes::Bytes;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// What one waiting piece costs beside its bytes, so that empty datagrams are bounded too.
pub(crate) const PIECE_COST_BYTES: usize = 64;

/// Bytes that wait, with their share of the bound.
#[derive(Debug)]
pub(crate) struct Piece {
    pub(crate) bytes: Bytes,
    _share: OwnedSemaphorePermit,
}

/// How much of one lane of one connection may wait.
#[derive(Clone, Debug)]
pub(crate) struct ByteCredit {
    bytes: Arc<Semaphore>,
}

impl ByteCredit {
    pub(crate) fn new(bytes: usize) -> Self {
        Self {
            bytes: Arc::new(Semaphore::new(bytes)),
        }
    }

    /// Waits until there is room.
    pub(crate) async fn admit(&self, bytes: &[u8]) -> Piece {
        let share = Arc::clone(&self.bytes)
            .acquire_many_owned(cost(bytes))
            .await
            .expect("nobody closes this semaphore");
        Piece::new(bytes, share)
    }

    /// None if there is no room now.
    pub(crate) fn try_admit(&self, bytes: &[u8]) -> Option<Piece> {
        let share = Arc::clone(&self.bytes)
            .try_acquire_many_owned(cost(bytes))
            .ok()?;
        Some(Piece::new(bytes, share))
    }
}

impl Piece {
    /// ReplicaSwitch: what arrived may be a sliver of a receive buffer of 64 KiB, which would then wait uncounted.
    fn new(bytes: &[u8], share: OwnedSemaphorePermit) -> Self {
        Self {
            bytes: Bytes::copy_from_slice(bytes),
            _share: share,
        }
    }
}

fn cost(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.len() + PIECE_COST_BYTES).expect("a piece is at most a read's bytes")
}
