//! Client over a Unix socket: it reads on its caller's thread.
//!
//! Control and state share the stream, in frames: a lane, a length, and bytes. Frames leave at once, or by a thread. No
//! bytes are interpreted here. A server has the same frames.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};
use std::{io, thread};

use bytes::{Buf, BufMut, Bytes, BytesMut};
use rhumb_protocol::Ending;
use rhumb_protocol::session::TransportCode;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{SendFlags, send};

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
        let received = match self.frames.next_frame() {
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
                Ok(0) | Err(Errno::INTR) => continue,
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

/// Most bytes of one frame.
pub const FRAME_BYTES_MAX: usize = 64 << 10;
/// Bytes of a frame before its payload.
const HEAD_BYTES: usize = 5;

/// Numbers of the lanes.
const CONTROL: u8 = 0;
const STATE: u8 = 1;
const END: u8 = 2;

/// One frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StreamFrame {
    /// The next bytes of the control stream.
    Control(Bytes),
    /// One state datagram.
    State(Bytes),
    /// The sender has closed the connection, with this code.
    End(u32),
}

/// The bytes cannot be frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidFrame;

/// Cuts a stream into frames.
#[derive(Debug, Default)]
pub struct FrameReader {
    bytes: BytesMut,
}

impl StreamFrame {
    /// The frame's bytes on the stream.
    pub fn encode(&self) -> Bytes {
        let (lane, payload) = match self {
            Self::Control(bytes) => (CONTROL, bytes.as_ref()),
            Self::State(bytes) => (STATE, bytes.as_ref()),
            Self::End(code) => (END, &code.to_le_bytes()[..]),
        };
        let mut out = BytesMut::with_capacity(HEAD_BYTES + payload.len());
        out.put_u8(lane);
        out.put_u32_le(u32::try_from(payload.len()).unwrap_or(u32::MAX));
        out.put_slice(payload);
        out.freeze()
    }
}

impl FrameReader {
    /// Adds received bytes.
    pub fn put(&mut self, bytes: &[u8]) {
        self.bytes.put_slice(bytes);
    }

    /// The next whole frame.
    pub fn next_frame(&mut self) -> Result<Option<StreamFrame>, InvalidFrame> {
        let Some(head) = self.bytes.get(..HEAD_BYTES) else {
            return Ok(None);
        };
        let lane = head[0];
        let length = u32::from_le_bytes([head[1], head[2], head[3], head[4]]) as usize;
        if lane > END || length > FRAME_BYTES_MAX {
            return Err(InvalidFrame);
        }
        if self.bytes.len() < HEAD_BYTES + length {
            return Ok(None);
        }
        self.bytes.advance(HEAD_BYTES);
        let mut payload = self.bytes.split_to(length).freeze();
        match lane {
            CONTROL => Ok(Some(StreamFrame::Control(payload))),
            STATE => Ok(Some(StreamFrame::State(payload))),
            _ if length == size_of::<u32>() => Ok(Some(StreamFrame::End(payload.get_u32_le()))),
            _ => Err(InvalidFrame),
        }
    }
}

/// Waiting bytes beyond which datagrams are dropped.
const STATE_WAITING_MAX: usize = 1 << 20;
/// Waiting bytes beyond which a connection ends.
const WAITING_MAX: usize = 12 << 20;
/// Time without progress after which a peer counts as gone.
const WRITE_TIMEOUT: Duration = Duration::from_secs(10);

/// The frames of one end that its socket has not taken.
pub struct Outgoing {
    socket: UnixStream,
    waiting: Mutex<Waiting>,
    changed: Condvar,
    /// Called when the thread has written.
    note_written: Box<dyn Fn() + Send + Sync>,
}

#[derive(Default)]
struct Waiting {
    frames: VecDeque<WaitingFrame>,
    bytes: usize,
    /// True while the thread writes frames that it has taken.
    writing: bool,
    /// True once nothing more may be sent.
    closed: bool,
    /// Control bytes that the socket has taken.
    taken: u64,
}

struct WaitingFrame {
    bytes: Bytes,
    /// Bytes of control in it.
    control: usize,
}

/// More waits for a peer than the bound allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overflow;

impl Outgoing {
    /// Starts the thread of a socket.
    pub fn start(
        socket: UnixStream,
        note_written: impl Fn() + Send + Sync + 'static,
    ) -> io::Result<Arc<Self>> {
        socket.set_write_timeout(Some(WRITE_TIMEOUT))?;
        let outgoing = Arc::new(Self {
            socket,
            waiting: Mutex::default(),
            changed: Condvar::new(),
            note_written: Box::new(note_written),
        });
        let on_thread = Arc::clone(&outgoing);
        thread::Builder::new()
            .name("rhumb-unix-out".to_owned())
            .spawn(move || on_thread.write_waiting())?;
        Ok(outgoing)
    }

    /// Sends control bytes, in as many frames as they need.
    pub fn send_control(&self, mut bytes: Bytes) -> Result<(), Overflow> {
        let mut waiting = self.lock();
        while !bytes.is_empty() {
            let piece = bytes.split_to(bytes.len().min(FRAME_BYTES_MAX));
            let control = piece.len();
            let bytes = StreamFrame::Control(piece).encode();
            self.send(&mut waiting, WaitingFrame { bytes, control })?;
        }
        Ok(())
    }

    /// Sends a datagram, unless too much waits. Returns whether it was sent.
    pub fn send_state(&self, bytes: Bytes) -> bool {
        let mut waiting = self.lock();
        if waiting.bytes > STATE_WAITING_MAX || bytes.len() > FRAME_BYTES_MAX {
            return false;
        }
        let bytes = StreamFrame::State(bytes).encode();
        self.send(&mut waiting, WaitingFrame { bytes, control: 0 })
            .is_ok()
    }

    /// Ends the stream with a code, after all that waits.
    pub fn close(&self, code: u32) {
        let mut waiting = self.lock();
        if !waiting.closed {
            let bytes = StreamFrame::End(code).encode();
            waiting.frames.push_back(WaitingFrame { bytes, control: 0 });
            waiting.closed = true;
        }
        self.changed.notify_all();
    }

    /// Ends the stream at once.
    pub fn abort(&self) {
        let mut waiting = self.lock();
        waiting.frames.clear();
        waiting.closed = true;
        self.changed.notify_all();
        // A socket that is not connected is ended already.
        let _ = self.socket.shutdown(Shutdown::Both);
    }

    /// Control bytes that the socket has taken so far.
    pub fn taken(&self) -> u64 {
        self.lock().taken
    }

    fn send(&self, waiting: &mut Waiting, mut frame: WaitingFrame) -> Result<(), Overflow> {
        if waiting.closed {
            return Ok(());
        }
        if waiting.frames.is_empty() && !waiting.writing {
            match send(
                &self.socket,
                &frame.bytes,
                SendFlags::DONTWAIT | SendFlags::NOSIGNAL,
            ) {
                Ok(sent) if sent == frame.bytes.len() => {
                    waiting.taken += frame.control as u64;
                    return Ok(());
                }
                Ok(sent) => frame.bytes = frame.bytes.slice(sent..),
                Err(Errno::AGAIN | Errno::INTR) => {}
                // The reader learns that the connection has ended.
                Err(_) => {
                    waiting.closed = true;
                    return Ok(());
                }
            }
        }
        if waiting.bytes + frame.bytes.len() > WAITING_MAX {
            return Err(Overflow);
        }
        waiting.bytes += frame.bytes.len();
        waiting.frames.push_back(frame);
        self.changed.notify_all();
        Ok(())
    }

    /// Writes the waiting frames until the stream has ended.
    fn write_waiting(&self) {
        let mut waiting = self.lock();
        loop {
            let frames = std::mem::take(&mut waiting.frames);
            if frames.is_empty() {
                if waiting.closed {
                    // As in `abort`.
                    let _ = self.socket.shutdown(Shutdown::Both);
                    return;
                }
                waiting = self.changed.wait(waiting).expect(LOCK);
                continue;
            }
            waiting.writing = true;
            drop(waiting);
            let mut socket = &self.socket;
            let (mut written, mut control, mut failed) = (0, 0, false);
            for frame in &frames {
                written += frame.bytes.len();
                control += frame.control as u64;
                failed = failed || socket.write_all(&frame.bytes).is_err();
            }
            waiting = self.lock();
            waiting.writing = false;
            waiting.bytes = waiting.bytes.saturating_sub(written);
            waiting.taken += control;
            if failed {
                waiting.frames.clear();
                waiting.closed = true;
            }
            (self.note_written)();
        }
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().expect(LOCK)
    }
}

const LOCK: &str = "nothing panics while frames are locked";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_cut_anywhere_has_the_same_frames() {
        let frames = [
            StreamFrame::Control(Bytes::from_static(b"hello")),
            StreamFrame::State(Bytes::new()),
            StreamFrame::State(Bytes::from(vec![7; FRAME_BYTES_MAX])),
            StreamFrame::End(0x104),
        ];
        let stream: Vec<u8> = frames.iter().flat_map(StreamFrame::encode).collect();
        for step in [1, 2, 7, 4_096, stream.len()] {
            let mut reader = FrameReader::default();
            let mut read = Vec::new();
            for piece in stream.chunks(step) {
                reader.put(piece);
                while let Some(frame) = reader.next_frame().expect("valid frames") {
                    read.push(frame);
                }
            }
            assert_eq!(read, frames);
        }
    }

    #[test]
    fn frames_of_no_lane_and_of_too_many_bytes_are_invalid() {
        for bytes in [
            [3, 0, 0, 0, 0],
            [CONTROL, 0xff, 0xff, 0xff, 0xff],
            [STATE, 1, 0, 1, 0],
            [END, 0, 0, 0, 0],
        ] {
            let mut reader = FrameReader::default();
            reader.put(&bytes);
            assert_eq!(reader.next_frame(), Err(InvalidFrame), "{bytes:?}");
        }
    }
}
