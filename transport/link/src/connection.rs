//! One connection at either end: its control bytes, and its end.
//!
//! Interprets no bytes. Control bytes have a bounded queue and a writer: order is kept, and accepted bytes are not
//! dropped while the connection lives. The end waits only on the caller's request, and the first close code counts.
//! Packets to a client need no connection id: one socket has one connection.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Duration;

use bytes::Bytes;
use quinn::{
    Connection, ConnectionError, ConnectionId, ConnectionIdGenerator, SendStream,
    TransportErrorCode, VarInt, WriteError,
};
use rhumb_protocol::Ending;
use rhumb_protocol::session::TransportCode;
use tokio::sync::{Notify, mpsc};
use tokio::time::{sleep, timeout};

use crate::client_transport::{PIECE_COST_BYTES, WireStatistics};
use crate::tuning::{CONTROL_QUEUE_BYTES, FLUSH};

/// The traffic of a connection so far.
pub fn wire_statistics(connection: &Connection) -> WireStatistics {
    let stats = connection.stats();
    WireStatistics {
        sent_bytes: stats.udp_tx.bytes,
        sent_datagrams: stats.udp_tx.datagrams,
        received_bytes: stats.udp_rx.bytes,
        received_datagrams: stats.udp_rx.datagrams,
        lost_packets: stats.path.lost_packets,
        round_trip: stats.path.rtt,
    }
}

/// The session of a browser that a connection carries.
pub trait CarriedSession: fmt::Debug + Send + Sync {
    /// Requests the end of the session, and of its connection, from any thread.
    fn close(&self, code: u32);

    /// The code that the peer closed the session with.
    fn peer_code(&self) -> Option<u32>;

    /// True for the code by which an end resets the streams of a session that it closes.
    fn is_end_of_session(&self, code: VarInt) -> bool;

    /// The session's code that a peer gave as that of the connection; `None` for an error of the connection.
    fn code_of_connection(&self, code: VarInt) -> Option<u32>;
}

/// The end of a connection: requested, performed and named from any thread.
#[derive(Debug)]
pub struct Closing {
    connection: Connection,
    /// The session of a browser, which takes its code before the connection ends.
    web: Option<Arc<dyn CarriedSession>>,
    own_code: AtomicU64,
    /// UDP datagrams sent before this end closed: the next one carries the close frame.
    sent_before: AtomicU64,
    flush_requested: Notify,
}

/// Larger than any close code: this end has not closed.
const NOT_CLOSED: u64 = u64::MAX;

impl Closing {
    pub fn of(connection: &Connection, web: Option<Arc<dyn CarriedSession>>) -> Arc<Self> {
        Arc::new(Self {
            connection: connection.clone(),
            web,
            own_code: AtomicU64::new(NOT_CLOSED),
            sent_before: AtomicU64::new(0),
            flush_requested: Notify::new(),
        })
    }

    /// Closes at once.
    pub fn now(&self, code: u32) {
        self.note(code);
        self.finish();
    }

    /// Closes once the queued bytes have arrived, or after a short wait; see `ControlWriter::run`.
    pub fn after_flush(&self, code: u32) {
        self.note(code);
        self.flush_requested.notify_one();
    }

    /// Waits until a close after a flush is requested. For one waiter.
    pub async fn flush_requested(&self) {
        self.flush_requested.notified().await;
    }

    /// Closes with the requested code, unless the connection has ended already: the first end counts.
    pub fn finish(&self) {
        let code = self.own_code().unwrap_or(TransportCode::LEFT.0);
        self.note(code);
        match &self.web {
            None => self.close_connection(VarInt::from_u32(code)),
            Some(web) => web.close(code),
        }
    }

    /// Closes the connection itself, by a code of its own.
    pub fn close_connection(&self, code: VarInt) {
        // Closing again would overwrite quinn's reason.
        if self.connection.close_reason().is_none() {
            self.sent_before
                .store(self.sent_datagrams(), Ordering::Relaxed);
            self.connection.close(code, b"");
        }
    }

    /// The control stream broke by this code: closes, unless so a browser ends its session, whose code is on its way.
    pub async fn control_broke(&self, code: VarInt) {
        let web = self.web.as_ref();
        let ends_session = web.is_some_and(|web| web.is_end_of_session(code));
        if !ends_session || timeout(FLUSH, self.connection.closed()).await.is_err() {
            self.now(TransportCode::NO_CONTROL_STREAM.0);
        }
    }

    /// Waits for the connection's end and names it: `Closed` for a code of either end.
    pub async fn ended(&self) -> Ending {
        match self.connection.closed().await {
            ConnectionError::ApplicationClosed(close) => {
                let code = match &self.web {
                    None => u32::try_from(close.error_code.into_inner()).ok(),
                    Some(web) => {
                        let code = self.code_of(&**web);
                        code.or_else(|| web.code_of_connection(close.error_code))
                    }
                };
                code.map_or(Ending::Broken, Ending::Closed)
            }
            ConnectionError::LocallyClosed => {
                let code = match &self.web {
                    None => self.own_code(),
                    Some(web) => self.code_of(&**web),
                };
                code.map_or(Ending::Broken, Ending::Closed)
            }
            // A browser closes so when a page is gone.
            ConnectionError::ConnectionClosed(close)
                if close.error_code == TransportErrorCode::NO_ERROR
                    && let Some(web) = &self.web =>
            {
                Ending::Closed(self.code_of(&**web).unwrap_or(TransportCode::LEFT.0))
            }
            ConnectionError::TimedOut => Ending::TimedOut,
            ConnectionError::VersionMismatch
            | ConnectionError::TransportError(_)
            | ConnectionError::ConnectionClosed(_)
            | ConnectionError::Reset
            | ConnectionError::CidsExhausted => Ending::Broken,
        }
    }

    /// True if the end is complete: the close frame has left, or the connection ended otherwise.
    pub fn close_has_left(&self) -> bool {
        match self.connection.close_reason() {
            Some(ConnectionError::LocallyClosed) => {
                self.sent_datagrams() > self.sent_before.load(Ordering::Relaxed)
            }
            Some(_) => true,
            None => false,
        }
    }

    fn sent_datagrams(&self) -> u64 {
        self.connection.stats().udp_tx.datagrams
    }

    /// The code that a session was closed with, by whichever end was first.
    fn code_of(&self, web: &dyn CarriedSession) -> Option<u32> {
        web.peer_code().or_else(|| self.own_code())
    }

    fn own_code(&self) -> Option<u32> {
        u32::try_from(self.own_code.load(Ordering::Relaxed)).ok()
    }

    fn note(&self, code: u32) {
        // An error means that an earlier code is set: the first code counts.
        let _ = self.own_code.compare_exchange(
            NOT_CLOSED,
            code.into(),
            Ordering::Relaxed,
            Ordering::Relaxed,
        );
    }
}

/// The sending end of a connection's control lane; usable from any thread. Dropping it ends the connection.
#[derive(Debug)]
pub struct ControlSender {
    commands: mpsc::UnboundedSender<ControlCommand>,
    progress: Arc<Progress>,
}

/// The reading end, which the I/O thread empties.
#[derive(Debug)]
pub struct ControlWriter {
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
pub struct ControlQueueOverflow;

#[derive(Debug)]
enum ControlCommand {
    Send(Bytes),
    Finish,
}

/// Both ends of an empty queue.
pub fn control_queue() -> (ControlSender, ControlWriter) {
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
    /// The queue has reached its bound: the bytes are not taken, and the connection must be closed.
    pub fn send(&self, bytes: Bytes) -> Result<(), ControlQueueOverflow> {
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
    pub fn taken_bytes(&self) -> u64 {
        self.progress.taken_bytes.load(Ordering::SeqCst)
    }

    /// Returns true if the queue is empty; otherwise the writer notifies once when it is.
    pub fn is_empty_or_notify(&self) -> bool {
        self.progress.empty_wanted.store(true, Ordering::SeqCst);
        self.progress.waiting_bytes.load(Ordering::SeqCst) == 0
    }

    /// Ends the connection with `code`, once the queued bytes have arrived or after a short wait.
    pub fn close(&self, closing: &Closing, code: u32) {
        closing.after_flush(code);
        let _ = self.commands.send(ControlCommand::Finish);
    }
}

impl ControlWriter {
    /// Writes queued bytes until the connection ends, or ends it on request.
    ///
    /// `on_empty` is called when the queue is empty, if the sender requested that. A peer that does not read delays the
    /// end by `FLUSH` at most.
    pub async fn run(&mut self, closing: &Closing, stream: &mut SendStream, on_empty: impl Fn()) {
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

/// Generates empty ids: the address alone identifies the connection.
pub struct Unnamed;

impl ConnectionIdGenerator for Unnamed {
    fn generate_cid(&mut self) -> ConnectionId {
        ConnectionId::new(&[])
    }

    fn cid_len(&self) -> usize {
        0
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}
