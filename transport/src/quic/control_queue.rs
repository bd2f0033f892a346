//! Outgoing control bytes: a bounded queue and its writer.
//!
//! Neither cuts nor interprets the bytes. Order is kept; accepted bytes are not dropped while the connection lives.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use bytes::Bytes;
use quinn::{SendStream, WriteError};
use tokio::sync::mpsc;
use tokio::time::sleep;

use super::closing::Closing;
use super::code::TransportCode;
use super::tuning::{CONTROL_QUEUE_BYTES, FLUSH};
use crate::piece::PIECE_COST_BYTES;

/// The sending end of a connection's control lane; usable from any thread. Dropping it ends the connection.
#[derive(Debug)]
pub(super) struct ControlSender {
    commands: mpsc::UnboundedSender<ControlCommand>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// The reading end, which the I/O thread empties.
#[derive(Debug)]
pub(super) struct ControlWriter {
    commands: mpsc::UnboundedReceiver<ControlCommand>,
    waiting_bytes: Arc<AtomicUsize>,
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
    let waiting_bytes = Arc::new(AtomicUsize::new(0));
    let writer = ControlWriter {
        commands: receiver,
        waiting_bytes: Arc::clone(&waiting_bytes),
    };
    (
        ControlSender {
            commands: sender,
            waiting_bytes,
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
        let waiting = self.waiting_bytes.fetch_add(cost, Ordering::Relaxed);
        if waiting + cost > CONTROL_QUEUE_BYTES {
            return Err(ControlQueueOverflow);
        }
        // Without a writer the connection has ended; its end is reported separately.
        let _ = self.commands.send(ControlCommand::Send(bytes));
        Ok(())
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
    /// A peer that does not read delays the end by `FLUSH` at most.
    pub(super) async fn run(&mut self, closing: &Closing, stream: &mut SendStream) {
        let late = async {
            closing.flush_requested().await;
            sleep(FLUSH).await;
        };
        tokio::select! {
            written = self.write(closing, stream) => match written {
                Ok(()) => closing.finish(),
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
    ) -> Result<(), WriteError> {
        loop {
            match self.commands.recv().await {
                Some(ControlCommand::Send(bytes)) => {
                    let cost = bytes.len() + PIECE_COST_BYTES;
                    stream.write_chunk(bytes).await?;
                    self.waiting_bytes.fetch_sub(cost, Ordering::Relaxed);
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
