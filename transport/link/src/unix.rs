//! Client over a Unix socket: it reads on its caller's thread.
//!
//! Control and state share the stream, in frames: a lane, a length, and bytes. Frames leave at once, or by a thread. No
//! bytes are interpreted here. A server has the same frames.

use std::collections::VecDeque;
use std::io::Read;
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
        let dropped = self.outgoing.send_state(bytes);
        if dropped > 0 {
            tracing::debug!(bytes_len, dropped, "state datagrams not sent");
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

/// Waiting bytes of datagrams, beyond which the oldest ones are dropped: new state supersedes old.
const STATE_WAITING_MAX: usize = 1 << 20;
/// Waiting control bytes beyond which a connection ends.
const CONTROL_WAITING_MAX: usize = 12 << 20;
/// Control bytes that count as taken while they wait. A peer that does not read for minutes stays, as one of the network
/// does, whose thread reads for it.
const TAKEN_BYTES_MAX: u64 = 1 << 20;
/// Time without progress after which the rest of a closed connection is given up.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(10);

/// The frames of one end that its socket has not taken.
///
/// A peer may be away for any time: its datagrams are superseded meanwhile, and its control bytes wait.
pub struct Outgoing {
    socket: UnixStream,
    waiting: Mutex<Waiting>,
    changed: Condvar,
    /// Called when the thread has written.
    note_written: Box<dyn Fn() + Send + Sync>,
}

#[derive(Default)]
struct Waiting {
    /// The rest of a frame of which the socket has taken a part: it goes first, and is never dropped.
    begun: Option<WaitingFrame>,
    control: FrameQueue,
    state: FrameQueue,
    /// The number of the next frame.
    next: u64,
    /// True while the thread writes a frame that it has taken.
    writing: bool,
    /// True once nothing more may be sent.
    closed: bool,
    /// Control bytes that were sent, and those that the socket has taken.
    sent: u64,
    written: u64,
}

/// The frames of one lane, each with its number among those of both.
#[derive(Default)]
struct FrameQueue {
    frames: VecDeque<(u64, WaitingFrame)>,
    bytes: usize,
}

struct WaitingFrame {
    bytes: Bytes,
    /// Bytes of control in it.
    control: usize,
}

/// More waits for a peer than the bound allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Overflow;

/// The socket takes no more: its peer is gone, or the connection is given up.
struct Gone;

impl FrameQueue {
    fn push(&mut self, number: u64, frame: WaitingFrame) {
        self.bytes += frame.bytes.len();
        self.frames.push_back((number, frame));
    }

    fn pop(&mut self) -> Option<WaitingFrame> {
        let (_, frame) = self.frames.pop_front()?;
        self.bytes -= frame.bytes.len();
        Some(frame)
    }

    fn first(&self) -> u64 {
        self.frames.front().map_or(u64::MAX, |(number, _)| *number)
    }
}

impl Waiting {
    /// True if the socket may take a frame at once.
    fn is_idle(&self) -> bool {
        let queued = self.control.bytes + self.state.bytes;
        queued == 0 && self.begun.is_none() && !self.writing
    }

    fn take_number(&mut self) -> u64 {
        self.next += 1;
        self.next
    }

    fn push(&mut self, frame: WaitingFrame) {
        let number = self.take_number();
        match frame.control {
            0 => self.state.push(number, frame),
            _ => self.control.push(number, frame),
        }
    }

    /// The next frame to write: the oldest one of both lanes.
    fn pop(&mut self) -> Option<WaitingFrame> {
        let first = self.begun.take();
        first.or_else(|| match self.state.first() < self.control.first() {
            true => self.state.pop(),
            false => self.control.pop(),
        })
    }

    /// Ends the stream; what waits is lost.
    fn give_up(&mut self) {
        self.closed = true;
        self.begun = None;
        self.control = FrameQueue::default();
        self.state = FrameQueue::default();
    }
}

impl Outgoing {
    /// Starts the thread of a socket.
    pub fn start(
        socket: UnixStream,
        note_written: impl Fn() + Send + Sync + 'static,
    ) -> io::Result<Arc<Self>> {
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
        if waiting.control.bytes + bytes.len() > CONTROL_WAITING_MAX {
            return Err(Overflow);
        }
        while !bytes.is_empty() {
            let piece = bytes.split_to(bytes.len().min(FRAME_BYTES_MAX));
            let control = piece.len();
            let bytes = StreamFrame::Control(piece).encode();
            self.send(&mut waiting, WaitingFrame { bytes, control });
        }
        Ok(())
    }

    /// Sends a datagram. If too many bytes wait, the oldest ones are dropped; returns the number of dropped datagrams.
    pub fn send_state(&self, bytes: Bytes) -> u64 {
        if bytes.len() > FRAME_BYTES_MAX {
            return 1;
        }
        let mut waiting = self.lock();
        let bytes = StreamFrame::State(bytes).encode();
        self.send(&mut waiting, WaitingFrame { bytes, control: 0 });
        let mut dropped = 0;
        while waiting.state.bytes > STATE_WAITING_MAX && waiting.state.pop().is_some() {
            dropped += 1;
        }
        dropped
    }

    /// Ends the stream with a code, after all that waits.
    pub fn close(&self, code: u32) {
        let mut waiting = self.lock();
        if !waiting.closed {
            let bytes = StreamFrame::End(code).encode();
            let number = waiting.take_number();
            waiting
                .control
                .push(number, WaitingFrame { bytes, control: 0 });
            waiting.closed = true;
        }
        self.changed.notify_all();
    }

    /// Ends the stream at once.
    pub fn abort(&self) {
        self.lock().give_up();
        self.changed.notify_all();
        // A socket that is not connected is ended already.
        let _ = self.socket.shutdown(Shutdown::Both);
    }

    /// Control bytes that count as taken so far: those that the socket has, and some that wait.
    pub fn taken(&self) -> u64 {
        let waiting = self.lock();
        waiting.sent.min(waiting.written + TAKEN_BYTES_MAX)
    }

    fn send(&self, waiting: &mut Waiting, mut frame: WaitingFrame) {
        if waiting.closed {
            return;
        }
        waiting.sent += frame.control as u64;
        if waiting.is_idle() {
            match self.try_write(&mut frame) {
                Ok(true) => {
                    waiting.written += frame.control as u64;
                    return;
                }
                Ok(false) => {}
                // The reader learns that the connection has ended.
                Err(Gone) => {
                    waiting.give_up();
                    return;
                }
            }
            waiting.begun = Some(frame);
        } else {
            waiting.push(frame);
        }
        self.changed.notify_all();
    }

    /// Writes what the socket takes of a frame at once; `true` if that is all of it.
    fn try_write(&self, frame: &mut WaitingFrame) -> Result<bool, Gone> {
        while !frame.bytes.is_empty() {
            let at_once = SendFlags::DONTWAIT | SendFlags::NOSIGNAL;
            match send(&self.socket, &frame.bytes, at_once) {
                Ok(sent) => frame.bytes.advance(sent),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) => return Ok(false),
                Err(_) => return Err(Gone),
            }
        }
        Ok(true)
    }

    /// Writes a frame, however long the peer does not read, unless this end has closed.
    fn write(&self, frame: &mut WaitingFrame) -> Result<(), Gone> {
        let slice = Timespec {
            tv_sec: i64::try_from(CLOSE_TIMEOUT.as_secs()).unwrap_or(i64::MAX),
            tv_nsec: 0,
        };
        while !self.try_write(frame)? {
            let was_closed = self.lock().closed;
            let mut writable = [PollFd::new(&self.socket, PollFlags::OUT)];
            match poll(&mut writable, Some(&slice)) {
                Ok(0) if was_closed => return Err(Gone),
                Ok(_) | Err(Errno::INTR) => {}
                Err(_) => return Err(Gone),
            }
        }
        Ok(())
    }

    /// Writes the waiting frames until the stream has ended.
    fn write_waiting(&self) {
        let mut waiting = self.lock();
        let mut unreported = 0;
        loop {
            let Some(mut frame) = waiting.pop() else {
                if waiting.closed {
                    // As in `abort`.
                    let _ = self.socket.shutdown(Shutdown::Both);
                    return;
                }
                waiting = self.changed.wait(waiting).expect(LOCK);
                continue;
            };
            waiting.writing = true;
            drop(waiting);
            let written = self.write(&mut frame);
            waiting = self.lock();
            waiting.writing = false;
            match written {
                Ok(()) => waiting.written += frame.control as u64,
                Err(Gone) => waiting.give_up(),
            }
            unreported += frame.control;
            let is_last = waiting.control.frames.is_empty();
            if unreported > 0 && (is_last || unreported >= FRAME_BYTES_MAX) {
                unreported = 0;
                (self.note_written)();
            }
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

    /// The frames that a peer gets when it reads all at last.
    fn read_all(mut socket: UnixStream) -> Vec<StreamFrame> {
        let mut bytes = Vec::new();
        socket.read_to_end(&mut bytes).expect("the stream ends");
        let mut reader = FrameReader::default();
        reader.put(&bytes);
        let next = || reader.next_frame().expect("valid frames");
        std::iter::from_fn(next).collect()
    }

    #[test]
    fn a_peer_that_was_away_gets_all_control_bytes_and_the_newest_state() {
        const SENT: u32 = 6_000;
        let (near, far) = UnixStream::pair().expect("the system has sockets");
        let outgoing = Outgoing::start(near, || {}).expect("a thread can start");
        let mut dropped = 0;
        for number in 0..SENT {
            let mut state = vec![0; 1_000];
            state[..4].copy_from_slice(&number.to_le_bytes());
            dropped += outgoing.send_state(state.into());
            if number % 100 == 0 {
                let control = Bytes::copy_from_slice(&number.to_le_bytes());
                assert_eq!(outgoing.send_control(control), Ok(()));
            }
        }
        // No time is too long for it.
        assert_eq!(outgoing.socket.write_timeout().ok(), Some(None));
        outgoing.close(7);
        let frames = read_all(far);
        let (mut state, mut control) = (Vec::new(), Vec::new());
        for frame in &frames {
            match frame {
                StreamFrame::State(bytes) => state.push(bytes.clone().get_u32_le()),
                StreamFrame::Control(bytes) => control.push(bytes.clone().get_u32_le()),
                StreamFrame::End(code) => assert_eq!(*code, 7),
            }
        }
        assert_eq!(frames.last(), Some(&StreamFrame::End(7)));
        let each: Vec<u32> = (0..SENT).step_by(100).collect();
        assert_eq!(control, each);
        assert!(state.is_sorted());
        assert_eq!(state.len() as u64 + dropped, u64::from(SENT));
        let kept = (STATE_WAITING_MAX / (1_000 + HEAD_BYTES)) as u32;
        let newest: Vec<u32> = (SENT - kept..SENT).collect();
        assert!(state.ends_with(&newest), "{state:?}");
    }

    #[test]
    fn some_control_bytes_count_as_taken_while_a_peer_is_away() {
        let (near, far) = UnixStream::pair().expect("the system has sockets");
        let outgoing = Outgoing::start(near, || {}).expect("a thread can start");
        let half = Bytes::from(vec![0; 512 << 10]);
        for _ in 0..2 {
            assert_eq!(outgoing.send_control(half.clone()), Ok(()));
        }
        assert_eq!(outgoing.taken(), 1 << 20);
        for _ in 0..8 {
            assert_eq!(outgoing.send_control(half.clone()), Ok(()));
        }
        assert!(outgoing.taken() < 5 << 20);
        outgoing.close(0);
        assert_eq!(read_all(far).len(), 10 * 8 + 1);
        assert_eq!(outgoing.taken(), 5 << 20);
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
