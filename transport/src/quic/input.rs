//! What the sockets tell the host thread, bounded.
//!
//! Decides nothing. Each waiting piece holds a permit of its connection, given back when the piece was handled.

use std::sync::Arc;

use bytes::Bytes;
use quinn::Connection;
use rhumb_protocol::{Ending, Peer};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::closing::Closing;
use super::control_queue::ControlSender;
use super::tuning::PIECE_COST_BYTES;

/// One thing for the host thread to handle.
#[derive(Debug)]
pub(super) enum Input {
    /// A connection stands.
    Opened { peer: Peer, line: Line },
    /// Bytes of its control stream.
    Control { peer: Peer, piece: Piece },
    /// One of its datagrams.
    State { peer: Peer, piece: Piece },
    /// It is gone; its last word.
    Ended { peer: Peer, ending: Ending },
    /// The server shall stop.
    Stop,
    /// The I/O thread is over: nothing more will come.
    IoOver,
}

/// How the host thread speaks to one connection.
#[derive(Debug)]
pub(super) struct Line {
    pub(super) connection: Connection,
    pub(super) control: ControlSender,
    pub(super) closing: Arc<Closing>,
}

/// Bytes that wait, with their share of the bound.
#[derive(Debug)]
pub(super) struct Piece {
    pub(super) bytes: Bytes,
    _share: OwnedSemaphorePermit,
}

/// How much of one lane of one connection may wait.
#[derive(Clone, Debug)]
pub(super) struct Allowance {
    bytes: Arc<Semaphore>,
}

impl Allowance {
    pub(super) fn new(bytes: usize) -> Self {
        Self {
            bytes: Arc::new(Semaphore::new(bytes)),
        }
    }

    /// Waits until there is room.
    pub(super) async fn admit(&self, bytes: &[u8]) -> Piece {
        let share = Arc::clone(&self.bytes)
            .acquire_many_owned(cost(bytes))
            .await
            .expect("nobody closes this semaphore");
        Piece::new(bytes, share)
    }

    /// None if there is no room now.
    pub(super) fn try_admit(&self, bytes: &[u8]) -> Option<Piece> {
        let share = Arc::clone(&self.bytes)
            .try_acquire_many_owned(cost(bytes))
            .ok()?;
        Some(Piece::new(bytes, share))
    }
}

impl Piece {
    /// Copies: what arrived may be a sliver of a receive buffer of 64 KiB, which would then wait uncounted.
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
