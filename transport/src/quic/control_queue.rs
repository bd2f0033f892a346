//! Outgoing control bytes: a bounded queue and its writer.
//!
//! Neither cuts nor interprets the bytes. Order is kept; accepted bytes are not dropped while the connection lives.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

use bytes::Bytes;
use quinn::{SendStream, WriteError};
use rhumb_protocol::session::TransportCode;
use tokio::sync::mpsc;
use tokio::time::sleep;

use super::closing::Closing;
use super::tuning::{CONTROL_QUEUE_BYTES, FLUSH};
use crate::piece::PIECE_COST_BYTES;

/// The sending end of a connection's control lane; usable from any thread. Dropping it ends the connection.
#[derive(Debug)]
pub(super) struct ControlSender {
    commands: mpsc::UnboundedSender<ControlCommand>,
    progress: Arc<Progress>,
}

/// The reading end, which the I/O thread empties.
#[derive(Debug)]
pub(super) struct ControlWriter {
    commands: mpsc::UnboundedReceiver<ControlCommand>,
    progress: Arc<Progress>,
}

/// The state of the queue that both ends see.
#[derive(Debug, Default)]
struct Progress {
    /// Cost of the queued pieces.
    waiting_bytes: AtomicUsize,
    /// Bytes that the connection has taken so far.
    taken_bytes: AtomicU64,
    /// True if the sender is to be notified when the queue is empty.
    empty_wanted: AtomicBool,
}

/// Error: the queue has reached its bound.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ControlQueueOverflow;

#[derive(Debug)]
enum ControlCommand {
    Send(Bytes),
    Finish,
}

/// Both ends of an empty queue.
pub(super) fn control_queue() -> (ControlSender, ControlWriter) {
    let (sender, receiver) = mpsc::unbounded_channel();
    let progress = Arc::new(Progress::default());
    let writer = ControlWriter {
        commands: receiver,
        progress: Arc::clone(&progress),
    };
    (
        ControlSender {
            commands: sender,
            progress,
        },
        writer,
    )
}

impl ControlSender {
    /// Appends bytes to the stream without waiting.
    ///
    /// # Errors
    ///
    /// The queue has reached its bound: the bytes are not taken and the connection cannot be used any more.
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), ControlQueueOverflow> {
        let cost = bytes.len() + PIECE_COST_BYTES;
        let waiting = self
            .progress
            .waiting_bytes
            .fetch_add(cost, Ordering::SeqCst);
        if waiting + cost > CONTROL_QUEUE_BYTES {
            return Err(ControlQueueOverflow);
        }
        // Without a writer the connection has ended; its end is reported separately.
        let _ = self.commands.send(ControlCommand::Send(bytes));
        Ok(())
    }

    /// Bytes that the connection has taken so far.
    pub(super) fn taken_bytes(&self) -> u64 {
        self.progress.taken_bytes.load(Ordering::SeqCst)
    }

    /// Returns true if the queue is empty; otherwise the writer notifies once when it is.
    pub(super) fn is_empty_or_notify(&self) -> bool {
        self.progress.empty_wanted.store(true, Ordering::SeqCst);
        self.progress.waiting_bytes.load(Ordering::SeqCst) == 0
    }

    /// Ends the connection with `code`, once the queued bytes have arrived or after a short wait.
    pub(super) fn close(&self, closing: &Closing, code: u32) {
        closing.after_flush(code);
        let _ = self.commands.send(ControlCommand::Finish);
    }
}

impl ControlWriter {
    /// Writes queued bytes until the connection ends, or ends it on request.
    ///
    /// `on_empty` is called when the queue is empty, if the sender requested that. A peer that does not read delays the
    /// end by `FLUSH` at most.
    pub(super) async fn run(
        &mut self,
        closing: &Closing,
        stream: &mut SendStream,
        on_empty: impl Fn(),
    ) {
        let late = async {
            closing.flush_requested().await;
            sleep(FLUSH).await;
        };
        tokio::select! {
            written = self.write(closing, stream, on_empty) => match written {
                Ok(()) => closing.finish(),
                Err(WriteError::Stopped(code)) => closing.control_broke(code).await,
                Err(_) => closing.now(TransportCode::NO_CONTROL_STREAM.0),
            },
            _ = closing.ended() => {}
            () = late => closing.finish(),
        }
    }

    /// Writes up to the last command and waits until all bytes have arrived.
    async fn write(
        &mut self,
        closing: &Closing,
        stream: &mut SendStream,
        on_empty: impl Fn(),
    ) -> Result<(), WriteError> {
        loop {
            match self.commands.recv().await {
                Some(ControlCommand::Send(bytes)) => {
                    let length = bytes.len();
                    let cost = length + PIECE_COST_BYTES;
                    stream.write_chunk(bytes).await?;
                    let progress = &self.progress;
                    progress
                        .taken_bytes
                        .fetch_add(length as u64, Ordering::SeqCst);
                    let before = progress.waiting_bytes.fetch_sub(cost, Ordering::SeqCst);
                    if before == cost && progress.empty_wanted.swap(false, Ordering::SeqCst) {
                        on_empty();
                    }
                }
                Some(ControlCommand::Finish) => break,
                None => {
                    closing.after_flush(TransportCode::LEFT.0);
                    break;
                }
            }
        }
        if stream.finish().is_ok() {
            // However the peer ends the stream, there is nothing more to wait for.
            let _ = stream.stopped().await;
        }
        Ok(())
    }
}
