//! Queues between the server thread and the sockets of the APP listener.

use core::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::Sender;

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_transport::{PIECE_COST_BYTES, Piece};
use tokio::sync::mpsc;

/// One input for the server thread.
#[derive(Debug)]
pub(super) enum AppInput {
    Opened {
        peer: Peer,
        from: SocketAddr,
        connection: AppConnection,
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

/// The I/O thread's end of the inputs.
#[derive(Clone)]
pub(super) struct AppInputSender {
    pub(super) inputs: Sender<AppInput>,
    /// Wakes the thread that takes the inputs.
    pub(super) wake: Arc<dyn Fn() + Send + Sync>,
}

/// Error: the server thread has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ServerEnded;

/// The sending end of a connection's outgoing bytes. Dropping it ends the connection, after the queued bytes.
#[derive(Debug)]
pub(super) struct AppConnection {
    queue: mpsc::UnboundedSender<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// The reading end, which the I/O thread empties.
#[derive(Debug)]
pub(super) struct AppConnectionReader {
    pub(super) queue: mpsc::UnboundedReceiver<Bytes>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// Error: the queue has reached its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AppQueueOverflow;

/// Queued bytes per client, at most: minutes of a busy region's updates over TCP.
const WAITING_BYTES_MAX: usize = 4 << 20;

impl AppInputSender {
    /// Passes an input to the server thread.
    pub(super) fn send(&self, input: AppInput) -> Result<(), ServerEnded> {
        self.inputs.send(input).map_err(|_| ServerEnded)?;
        (self.wake)();
        Ok(())
    }
}

pub(super) fn connection_queue() -> (AppConnection, AppConnectionReader) {
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
    /// Appends bytes without waiting.
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), AppQueueOverflow> {
        let cost = bytes.len() + PIECE_COST_BYTES;
        let waiting = self.waiting_bytes.fetch_add(cost, Ordering::Relaxed);
        if waiting + cost > WAITING_BYTES_MAX {
            return Err(AppQueueOverflow);
        }
        // Without a reader the connection has ended; its end is reported separately.
        let _ = self.queue.send(bytes);
        Ok(())
    }

    /// Cost of the queued bytes, with the fixed cost of each piece.
    pub(super) fn waiting_bytes(&self) -> usize {
        self.waiting_bytes.load(Ordering::Relaxed)
    }
}

impl AppConnectionReader {
    /// Returns the cost of written bytes.
    pub(super) fn left(&self, bytes: usize) {
        let cost = bytes + PIECE_COST_BYTES;
        self.waiting_bytes.fetch_sub(cost, Ordering::Relaxed);
    }
}
