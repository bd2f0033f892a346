//! End of one connection: requested, performed and named in one place.
//!
//! Waits only on the caller's request. The first close code counts.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use quinn::{Connection, ConnectionError, TransportErrorCode, VarInt};
use rhumb_protocol::Ending;
use rhumb_protocol::session::TransportCode;
use tokio::sync::Notify;
use tokio::time::timeout;

use super::tuning::FLUSH;
use super::web_session::{WebSession, is_end_of_session, session_code};

/// The end of a connection: requested, performed and named from any thread.
#[derive(Debug)]
pub(super) struct Closing {
    connection: Connection,
    /// The session of a browser, which takes its code before the connection ends.
    web: Option<Arc<WebSession>>,
    own_code: AtomicU64,
    /// UDP datagrams sent before this end closed: the next one carries the close frame.
    sent_before: AtomicU64,
    flush_requested: Notify,
}

/// Larger than any close code: this end has not closed.
const NOT_CLOSED: u64 = u64::MAX;

impl Closing {
    pub(super) fn of(connection: &Connection, web: Option<Arc<WebSession>>) -> Arc<Self> {
        Arc::new(Self {
            connection: connection.clone(),
            web,
            own_code: AtomicU64::new(NOT_CLOSED),
            sent_before: AtomicU64::new(0),
            flush_requested: Notify::new(),
        })
    }

    /// Closes at once.
    pub(super) fn now(&self, code: u32) {
        self.note(code);
        self.finish();
    }

    /// Closes once the queued bytes have arrived, or after a short wait; see `ControlWriter::run`.
    pub(super) fn after_flush(&self, code: u32) {
        self.note(code);
        self.flush_requested.notify_one();
    }

    /// Waits until a close after a flush is requested. For one waiter.
    pub(super) async fn flush_requested(&self) {
        self.flush_requested.notified().await;
    }

    /// Closes with the requested code, unless the connection has ended already: the first end counts.
    pub(super) fn finish(&self) {
        let code = self.own_code().unwrap_or(TransportCode::LEFT.0);
        self.note(code);
        match &self.web {
            None => self.close_connection(VarInt::from_u32(code)),
            Some(web) => web.close(code),
        }
    }

    /// Closes the connection itself, by a code of its own.
    pub(super) fn close_connection(&self, code: VarInt) {
        // Closing again would overwrite quinn's reason.
        if self.connection.close_reason().is_none() {
            self.sent_before
                .store(self.sent_datagrams(), Ordering::Relaxed);
            self.connection.close(code, b"");
        }
    }

    /// The control stream broke by this code: closes, unless so a browser ends its session, whose code is on its way.
    pub(super) async fn control_broke(&self, code: VarInt) {
        let ends_session = self.web.is_some() && is_end_of_session(code);
        if !ends_session || timeout(FLUSH, self.connection.closed()).await.is_err() {
            self.now(TransportCode::NO_CONTROL_STREAM.0);
        }
    }

    /// Waits for the connection's end and names it: `Closed` for a code of either end.
    pub(super) async fn ended(&self) -> Ending {
        match self.connection.closed().await {
            ConnectionError::ApplicationClosed(close) => {
                let code = match &self.web {
                    None => u32::try_from(close.error_code.into_inner()).ok(),
                    Some(web) => self.code_of(web).or_else(|| session_code(close.error_code)),
                };
                code.map_or(Ending::Broken, Ending::Closed)
            }
            ConnectionError::LocallyClosed => {
                let code = match &self.web {
                    None => self.own_code(),
                    Some(web) => self.code_of(web),
                };
                code.map_or(Ending::Broken, Ending::Closed)
            }
            // A browser closes so when a page is gone.
            ConnectionError::ConnectionClosed(close)
                if close.error_code == TransportErrorCode::NO_ERROR
                    && let Some(web) = &self.web =>
            {
                Ending::Closed(self.code_of(web).unwrap_or(TransportCode::LEFT.0))
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
    pub(super) fn close_has_left(&self) -> bool {
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
    fn code_of(&self, web: &WebSession) -> Option<u32> {
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
