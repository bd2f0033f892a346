//! What the host thread and the sockets of the second listener tell each other.

use core::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;
use rhumb_protocol::Peer;
use tokio::sync::mpsc;

use crate::piece::{PIECE_COST_BYTES, Piece};

/// One thing for the host thread to handle.
#[derive(Debug)]
pub(crate) enum AppInput {
    Opened {
        peer: Peer,
        from: SocketAddr,
        line: AppConnection,
    },
    Bytes {
        peer: Peer,
        piece: Piece,
    },
    Datagram {
        from: SocketAddr,
        piece: Piece,
    },
    Ended {
        peer: Peer,
    },
}

/// The near end of a connection's outgoing bytes. Dropping it ends the connection, after what was sent.
#[derive(Debug)]
pub(crate) struct AppConnection {
    queue: mpsc::UnboundedSender<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// The far end, which the I/O thread empties.
#[derive(Debug)]
pub(super) struct AppConnectionReader {
    pub(super) queue: mpsc::UnboundedReceiver<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// More bytes wait than the bound allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Overflow;

/// Bytes that may wait for one client: minutes of what a busy region is told on TCP.
const WAITING_BYTES_MAX: usize = 4 << 20;

pub(super) fn line() -> (AppConnection, AppConnectionReader) {
    let (sender, receiver) = mpsc::unbounded_channel();
    let waiting_bytes = Arc::new(AtomicUsize::new(0));
    let near = AppConnection {
        queue: sender,
        waiting_bytes: Arc::clone(&waiting_bytes),
    };
    let far = AppConnectionReader {
        queue: receiver,
        waiting_bytes,
    };
    (near, far)
}

impl AppConnection {
    /// Appends bytes, without waiting.
    pub(crate) fn send(&self, bytes: Bytes) -> Result<(), Overflow> {
        let cost = bytes.len() + PIECE_COST_BYTES;
        let waiting = self.waiting_bytes.fetch_add(cost, Ordering::Relaxed);
        if waiting + cost > WAITING_BYTES_MAX {
            return Err(Overflow);
        }
        // No reader, no connection: its end is told elsewhere.
        let _ = self.queue.send(bytes);
        Ok(())
    }

    /// What was sent and has not left, each piece with what it costs.
    pub(crate) fn waiting_bytes(&self) -> usize {
        self.waiting_bytes.load(Ordering::Relaxed)
    }
}

impl AppConnectionReader {
    /// Bytes have left.
    pub(super) fn left(&self, bytes: usize) {
        let cost = bytes + PIECE_COST_BYTES;
        self.waiting_bytes.fetch_sub(cost, Ordering::Relaxed);
    }
}
