//! Control bytes on their way out: a bounded queue and its writer.
//!
//! Does not cut or understand the bytes. ControlCommand is kept; nothing that was accepted is dropped while the connection lives.

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

/// The near end of a connection's control lane; usable from any thread. Dropping it ends the connection.
#[derive(Debug)]
pub(super) struct ControlSender {
    commands: mpsc::UnboundedSender<ControlCommand>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// The far end, which the I/O thread empties.
#[derive(Debug)]
pub(super) struct ControlWriter {
    commands: mpsc::UnboundedReceiver<ControlCommand>,
    waiting_bytes: Arc<AtomicUsize>,
}

/// More bytes wait than the bound allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Overflow;

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
    /// Appends bytes to the stream, without waiting.
    ///
    /// # Errors
    ///
    /// The bound is reached; the bytes are not taken and the connection is of no more use.
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), Overflow> {
        let cost = bytes.len() + PIECE_COST_BYTES;
        let waiting = self.waiting_bytes.fetch_add(cost, Ordering::Relaxed);
        if waiting + cost > CONTROL_QUEUE_BYTES {
            return Err(Overflow);
        }
        // No writer, no connection: its end is reported elsewhere.
        let _ = self.commands.send(ControlCommand::Send(bytes));
        Ok(())
    }

    /// Ends the connection with `code`, after what was sent before has arrived or after a short wait.
    pub(super) fn close(&self, closing: &Closing, code: u32) {
        closing.after_flush(code);
        let _ = self.commands.send(ControlCommand::Finish);
    }
}

impl ControlWriter {
    /// Writes what is queued until the connection ends, or ends it when that is asked for.
    ///
    /// A peer that does not read cannot hold up the end for longer than `FLUSH`.
    pub(super) async fn run(&mut self, closing: &Closing, stream: &mut SendStream) {
        let late = async {
            closing.asked().await;
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

    /// Writes to the last order and waits until all of it has arrived.
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
