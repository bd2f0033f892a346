//! Client over a Unix socket: it reads on its caller's thread.

use std::io;
use std::io::Read;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;
use rhumb_protocol::Ending;
use rhumb_protocol::session::TransportCode;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::frame::{FrameReader, Outgoing, StreamFrame};
use crate::client_transport::{ClientTransport, Received, WireStatistics};

/// Bytes of one read.
const READ_BYTES: usize = 64 << 10;
/// Longest wait in one call of the system; a longer one is repeated.
const WAIT_MAX: Duration = Duration::from_secs(3_600);

/// An open connection to a server of the same machine, until one end closes it.
pub struct UnixClient {
    socket: UnixStream,
    outgoing: Arc<Outgoing>,
    frames: FrameReader,
    buffer: Box<[u8]>,
    ended: Ended,
    sent_bytes: AtomicU64,
    sent_datagrams: AtomicU64,
    received_bytes: u64,
    received_datagrams: u64,
}

/// The end of a connection, for its caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ended {
    Not,
    Delivered,
}

impl UnixClient {
    /// Connects to the socket at a path.
    ///
    /// # Errors
    /// An I/O error: no socket, no listener, or no permission.
    pub fn connect(path: &Path) -> io::Result<Self> {
        let socket = UnixStream::connect(path)?;
        let outgoing = Outgoing::start(socket.try_clone()?, || {})?;
        Ok(Self {
            socket,
            outgoing,
            frames: FrameReader::default(),
            buffer: vec![0; READ_BYTES].into_boxed_slice(),
            ended: Ended::Not,
            sent_bytes: AtomicU64::new(0),
            sent_datagrams: AtomicU64::new(0),
            received_bytes: 0,
            received_datagrams: 0,
        })
    }

    fn count_sent(&self, bytes: usize) {
        self.sent_bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.sent_datagrams.fetch_add(1, Ordering::Relaxed);
    }

    /// The next whole frame that was received.
    fn next(&mut self) -> Option<Received> {
        let received = match self.frames.next() {
            Ok(None) => return None,
            Ok(Some(StreamFrame::Control(bytes))) => Received::Control(bytes),
            Ok(Some(StreamFrame::State(bytes))) => Received::State(bytes),
            Ok(Some(StreamFrame::End(code))) => return Some(self.end(Ending::Closed(code))),
            Err(_) => return Some(self.end(Ending::Broken)),
        };
        let (Received::Control(bytes) | Received::State(bytes)) = &received else {
            return Some(received);
        };
        self.received_bytes += bytes.len() as u64;
        self.received_datagrams += 1;
        Some(received)
    }

    fn end(&mut self, ending: Ending) -> Received {
        self.ended = Ended::Delivered;
        self.outgoing.abort();
        Received::Ended(ending)
    }
}

impl ClientTransport for UnixClient {
    /// If too much waits for the server, the connection closes with [`TransportCode::CONTROL_OVERFLOW`].
    fn send_control(&self, bytes: Bytes) {
        self.count_sent(bytes.len());
        if self.outgoing.send_control(bytes).is_err() {
            self.outgoing.close(TransportCode::CONTROL_OVERFLOW.0);
        }
    }

    fn send_state(&self, bytes: Bytes) {
        let bytes_len = bytes.len();
        self.count_sent(bytes_len);
        if !self.outgoing.send_state(bytes) {
            tracing::debug!(bytes_len, "state datagram not sent");
        }
    }

    fn close(&self, code: u32) {
        self.outgoing.close(code);
    }

    fn recv(&mut self, timeout: Duration) -> Option<Received> {
        let until = Instant::now().checked_add(timeout);
        loop {
            if self.ended == Ended::Delivered {
                return None;
            }
            if let Some(received) = self.next() {
                return Some(received);
            }
            let left = until.map_or(WAIT_MAX, |until| {
                until
                    .saturating_duration_since(Instant::now())
                    .min(WAIT_MAX)
            });
            let left = Timespec {
                tv_sec: i64::try_from(left.as_secs()).unwrap_or(i64::MAX),
                tv_nsec: left.subsec_nanos().into(),
            };
            let mut readable = [PollFd::new(&self.socket, PollFlags::IN)];
            match poll(&mut readable, Some(&left)) {
                Ok(0) if until.is_some_and(|until| until <= Instant::now()) => return None,
                Ok(0) | Err(rustix::io::Errno::INTR) => continue,
                Ok(_) => {}
                Err(_) => return Some(self.end(Ending::Broken)),
            }
            match self.socket.read(&mut self.buffer) {
                Ok(0) => return Some(self.end(Ending::Broken)),
                Ok(bytes) => self.frames.put(&self.buffer[..bytes]),
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => return Some(self.end(Ending::Broken)),
            }
        }
    }

    /// Counts frames and their payloads.
    fn statistics(&self) -> WireStatistics {
        WireStatistics {
            sent_bytes: self.sent_bytes.load(Ordering::Relaxed),
            sent_datagrams: self.sent_datagrams.load(Ordering::Relaxed),
            received_bytes: self.received_bytes,
            received_datagrams: self.received_datagrams,
            ..WireStatistics::default()
        }
    }
}

impl Drop for UnixClient {
    /// Closes if neither end did.
    fn drop(&mut self) {
        self.outgoing.close(TransportCode::LEFT.0);
    }
}
