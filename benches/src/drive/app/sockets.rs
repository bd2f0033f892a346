//! Sockets of the paper's protocol: read by the caller, or polled by threads.
//!
//! The send cap and the buffer size follow the client's defects. Bytes are counted like those of a `Frame`: adding 28
//! bytes per datagram gives bytes on the wire. A TCP segment has 12 header bytes more and is acknowledged by an empty
//! packet of 40.
//!
//! Three threads, as in the original. One pumps TCP every 30 ms, out and in. One reads datagrams as they arrive. One
//! processes received messages every 10 ms, 5,000 of each transport. No order holds across them.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use bytes::Bytes;
use rhumb_app::{Message, MessageFraming};

use super::replica::{AppReplica, AwaitedEnd, Defects};
use crate::drive::process::SERVER_TIMEOUT;
use crate::drive::remote::Retention;
use crate::record::PacketDirection;

/// The connected sockets.
#[derive(Debug)]
pub(super) struct Sockets {
    pub(super) tcp: TcpStream,
    pub(super) udp: UdpSocket,
    /// Number of state datagrams that the buffer of `udp` holds.
    pub(super) buffer_datagrams: usize,
    /// See [`END_LOST_AFTER`].
    end_timeout: Duration,
}

/// A connection that its caller reads.
#[derive(Debug)]
pub(super) struct Direct {
    sockets: Sockets,
    defects: Defects,
    frames: MessageFraming,
    buffer: Vec<u8>,
}

/// Buffer of a client without defects: holds a frame of more than ten thousand bodies.
#[cfg(target_os = "linux")]
const BUFFER_BYTES: usize = 16 << 20;
/// The default on Linux, which the published client keeps; the kernel doubles the requested size.
#[cfg(target_os = "linux")]
const DEFAULT_BUFFER_BYTES: usize = 212_992 / 2;
/// Silence after the first message of a frame after which its end counts as lost. The published simulator then begins
/// its next frame: 11.33 times a second.
pub(super) const END_LOST_AFTER: Duration = Duration::from_nanos(88_261_253);
/// Kernel memory that a state datagram takes in the socket buffer: 277 fit into the default one.
const KEPT_BYTES: usize = 768;
/// Messages that the published client sends per turn of its pump.
pub(super) const MESSAGES_PER_POLL: usize = 50;
/// Interval between two turns of its pump.
pub(super) const PUMP: Duration = Duration::from_millis(30);
/// Size of one TCP read.
pub(super) const READ_BYTES: usize = 64 << 10;

impl Sockets {
    /// Connects both sockets. Sends the logon by datagram, as the published client does, before the one on TCP.
    pub(super) fn open(server: SocketAddr, defects: Defects) -> io::Result<Self> {
        let udp = UdpSocket::bind("127.0.0.1:0")?;
        let buffer_datagrams = set_buffer(&udp, defects)? / KEPT_BYTES;
        udp.connect(server)?;
        let tcp = TcpStream::connect(server)?;
        Ok(Self {
            tcp,
            udp,
            buffer_datagrams,
            end_timeout: END_LOST_AFTER,
        })
    }
}

/// Sets the buffer size of the published client or a large one; returns the actual size in bytes.
#[cfg(target_os = "linux")]
fn set_buffer(udp: &UdpSocket, defects: Defects) -> io::Result<usize> {
    use rustix::net::sockopt::{
        set_socket_recv_buffer_size, set_socket_recv_buffer_size_force, socket_recv_buffer_size,
    };
    if defects.buffer {
        set_socket_recv_buffer_size(udp, DEFAULT_BUFFER_BYTES)?;
    } else if set_socket_recv_buffer_size_force(udp, BUFFER_BYTES).is_err() {
        // Without the privilege, the largest size allowed for any process.
        set_socket_recv_buffer_size(udp, BUFFER_BYTES)?;
    }
    Ok(socket_recv_buffer_size(udp)?)
}

/// On other systems the socket keeps its buffer, so this defect is not modelled.
#[cfg(not(target_os = "linux"))]
fn set_buffer(_: &UdpSocket, _: Defects) -> io::Result<usize> {
    Ok(0)
}

impl Direct {
    pub(super) fn new(sockets: Sockets, defects: Defects) -> io::Result<Self> {
        sockets.tcp.set_nodelay(true)?;
        Ok(Self {
            sockets,
            defects,
            frames: MessageFraming::default(),
            buffer: vec![0; READ_BYTES],
        })
    }

    /// Sends messages; one write for all that leave together.
    pub(super) fn send(&mut self, messages: &[Vec<u8>], wire: &mut WireCounter) -> io::Result<()> {
        if !self.defects.cap {
            return self.write(&messages.concat(), wire);
        }
        let mut turns = messages.chunks(MESSAGES_PER_POLL).peekable();
        while let Some(turn) = turns.next() {
            self.write(&turn.concat(), wire)?;
            if turns.peek().is_some() {
                thread::sleep(PUMP);
            }
        }
        Ok(())
    }

    fn write(&mut self, bytes: &[u8], wire: &mut WireCounter) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        wire.segments_up(bytes);
        self.sockets.tcp.write_all(bytes)
    }

    /// Processes datagrams that arrive after their frame was abandoned.
    pub(super) fn catch_up(
        &mut self,
        replica: &mut AppReplica,
        wire: &mut WireCounter,
    ) -> io::Result<()> {
        if !replica.may_lose(self.sockets.buffer_datagrams) {
            return Ok(());
        }
        self.sockets.udp.set_nonblocking(true)?;
        let result = loop {
            match self.receive_one(replica, wire) {
                Ok(()) => {}
                Err(cause) if is_nothing_yet(&cause) => break Ok(()),
                Err(cause) => break Err(cause),
            }
        };
        self.sockets.udp.set_nonblocking(false)?;
        result
    }

    /// Reads until one more frame ends, then processes pending TCP messages. Where a burst may overflow the socket
    /// buffer, silence after the first message of a frame also ends it.
    ///
    /// Returns an error if the server is silent for [`SERVER_TIMEOUT`].
    pub(super) fn receive(
        &mut self,
        replica: &mut AppReplica,
        wire: &mut WireCounter,
    ) -> io::Result<()> {
        let awaited = replica.await_end();
        let may_lose = replica.may_lose(self.sockets.buffer_datagrams);
        // A server that steps is silent for any length of time. An end counts as lost only after other messages of its
        // frame.
        self.sockets.udp.set_read_timeout(Some(SERVER_TIMEOUT))?;
        let mut silent = true;
        while !replica.has_ended(awaited) {
            match self.receive_one(replica, wire) {
                Ok(()) if may_lose && std::mem::take(&mut silent) => {
                    let end_timeout = self.sockets.end_timeout;
                    self.sockets.udp.set_read_timeout(Some(end_timeout))?;
                }
                Ok(()) => {}
                // The process was stopped for a while; the read is repeated.
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) if is_nothing_yet(&cause) && !silent => {
                    replica.abandon();
                    break;
                }
                Err(cause) if is_nothing_yet(&cause) => return Err(io::ErrorKind::TimedOut.into()),
                Err(cause) => return Err(cause),
            }
        }
        self.receive_tcp(replica, wire)
    }

    fn receive_one(&mut self, replica: &mut AppReplica, wire: &mut WireCounter) -> io::Result<()> {
        let count = self.sockets.udp.recv(&mut self.buffer)?;
        let datagram = &self.buffer[..count];
        wire.datagram_down(datagram);
        receive_datagram(datagram, replica)
    }

    pub(super) fn receive_tcp(
        &mut self,
        replica: &mut AppReplica,
        wire: &mut WireCounter,
    ) -> io::Result<()> {
        self.sockets.tcp.set_nonblocking(true)?;
        let result = loop {
            match self.sockets.tcp.read(&mut self.buffer) {
                Ok(0) => break Err(io::ErrorKind::ConnectionAborted.into()),
                Ok(count) => {
                    wire.segments_down(&self.buffer[..count]);
                    self.frames.push(&self.buffer[..count]);
                }
                Err(cause) if is_nothing_yet(&cause) => break Ok(()),
                Err(cause) => break Err(cause),
            }
        };
        self.sockets.tcp.set_nonblocking(false)?;
        result?;
        while let Some(message) = next_message(&mut self.frames)? {
            replica.receive(&message);
        }
        Ok(())
    }

    pub(super) fn send_datagram(&mut self, bytes: &[u8], wire: &mut WireCounter) -> io::Result<()> {
        wire.datagram_up(bytes);
        self.sockets.udp.send(bytes).map(drop)
    }
}

/// Processes all messages of a datagram, one or several packed.
pub(super) fn receive_datagram(datagram: &[u8], replica: &mut AppReplica) -> io::Result<()> {
    let mut frames = MessageFraming::default();
    frames.push(datagram);
    while let Some(message) = next_message(&mut frames)? {
        replica.receive(&message);
    }
    Ok(())
}

/// The next message; undecodable bytes are a server error.
pub(super) fn next_message(frames: &mut MessageFraming) -> io::Result<Option<Message>> {
    let framed = frames.next_message();
    let framed =
        framed.map_err(|malformed| io::Error::new(io::ErrorKind::InvalidData, malformed))?;
    Ok(framed.map(|framed| framed.message))
}

/// True if a read failed only for lack of data.
pub(super) fn is_nothing_yet(cause: &io::Error) -> bool {
    matches!(
        cause.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

/// Header bytes of a TCP segment beyond those of a datagram: 40 less 28.
const SEGMENT_MORE_BYTES: u64 = 12;
/// Payload of a full segment: an Ethernet packet of 1,500 bytes less 40 of headers.
const SEGMENT_BYTES: usize = 1_460;

/// Bytes and packets in one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Count {
    pub(super) bytes: u64,
    pub(super) packets: u64,
}

/// Counts in both directions, and the bytes since they were last taken, if kept.
#[derive(Debug)]
pub(super) struct WireCounter {
    pub(super) down: Count,
    pub(super) up: Count,
    keep: Retention,
    state_down: Vec<u8>,
    control_down: Vec<u8>,
    control_up: Vec<u8>,
    datagram_up: Vec<u8>,
}

impl Count {
    fn add(&mut self, packets: u64, bytes: u64) {
        self.packets += packets;
        self.bytes += bytes;
    }

    pub(super) const fn since(self, before: Self) -> Self {
        Self {
            bytes: self.bytes - before.bytes,
            packets: self.packets - before.packets,
        }
    }
}

impl WireCounter {
    pub(super) fn new(keep: Retention) -> Self {
        Self {
            down: Count::default(),
            up: Count::default(),
            keep,
            state_down: Vec::new(),
            control_down: Vec::new(),
            control_up: Vec::new(),
            datagram_up: Vec::new(),
        }
    }

    pub(super) fn datagram_down(&mut self, bytes: &[u8]) {
        self.down.add(1, bytes.len() as u64);
        keep(self.keep, bytes, &mut self.state_down);
    }

    pub(super) fn datagram_up(&mut self, bytes: &[u8]) {
        self.up.add(1, bytes.len() as u64);
        keep(self.keep, bytes, &mut self.datagram_up);
    }

    /// Counts one read from TCP.
    pub(super) fn segments_down(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.down.add(segments, bytes.len() as u64 + more);
        self.up.add(segments, more);
        keep(self.keep, bytes, &mut self.control_down);
    }

    /// Counts one write to TCP.
    pub(super) fn segments_up(&mut self, bytes: &[u8]) {
        let segments = bytes.len().div_ceil(SEGMENT_BYTES) as u64;
        let more = segments * SEGMENT_MORE_BYTES;
        self.up.add(segments, bytes.len() as u64 + more);
        self.down.add(segments, more);
        keep(self.keep, bytes, &mut self.control_up);
    }

    /// Takes the bytes since the last call, one piece per direction.
    pub(super) fn take(&mut self) -> Vec<(PacketDirection, Bytes)> {
        let lanes = [
            (PacketDirection::ControlUp, &mut self.control_up),
            (PacketDirection::StateUp, &mut self.datagram_up),
            (PacketDirection::StateDown, &mut self.state_down),
            (PacketDirection::ControlDown, &mut self.control_down),
        ];
        let full = lanes.into_iter().filter(|(_, bytes)| !bytes.is_empty());
        full.map(|(direction, bytes)| (direction, Bytes::from(std::mem::take(bytes))))
            .collect()
    }
}

fn keep(keep: Retention, bytes: &[u8], lane: &mut Vec<u8>) {
    if keep == Retention::Everything {
        lane.extend_from_slice(bytes);
    }
}

/// Interval between two turns of the thread that processes received messages.
const MESSENGER: Duration = Duration::from_millis(10);
/// Messages of each transport that it processes per turn.
const MESSAGES_PER_TURN: usize = 5_000;
/// Longest wait of a thread for a datagram before it checks whether to stop.
const STOP_CHECK: Duration = Duration::from_millis(50);

/// A connection that threads read.
#[derive(Debug)]
pub(super) struct Polled {
    shared: Arc<PolledState>,
    udp: UdpSocket,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct PolledState {
    /// Messages waiting to be sent.
    out: Mutex<VecDeque<Vec<u8>>>,
    queues: Mutex<ReceiveQueues>,
    replica: Mutex<ReceivedState>,
    /// Signalled when a frame or the connection ends.
    ended: Condvar,
    /// Number of state datagrams that the socket buffer holds.
    buffer_datagrams: usize,
}

/// Received messages not yet processed.
#[derive(Debug, Default)]
struct ReceiveQueues {
    tcp: VecDeque<Message>,
    udp: VecDeque<Vec<u8>>,
    /// The time at which a message was last received or sent.
    last: Option<Instant>,
    /// True if anything arrived since messages were last queued.
    answered: bool,
    /// True if a thread is processing messages.
    taking: bool,
}

/// Results of processed messages.
#[derive(Debug)]
struct ReceivedState {
    replica: AppReplica,
    wire: WireCounter,
    over: Option<io::ErrorKind>,
}

impl Polled {
    /// Starts the threads.
    pub(super) fn start(
        sockets: Sockets,
        defects: Defects,
        replica: AppReplica,
        wire: WireCounter,
    ) -> io::Result<Self> {
        let shared = Arc::new(PolledState {
            out: Mutex::default(),
            queues: Mutex::default(),
            replica: Mutex::new(ReceivedState {
                replica,
                wire,
                over: None,
            }),
            ended: Condvar::new(),
            buffer_datagrams: sockets.buffer_datagrams,
        });
        let udp = sockets.udp.try_clone()?;
        udp.set_read_timeout(Some(STOP_CHECK))?;
        let message_limit = if defects.cap {
            MESSAGES_PER_POLL
        } else {
            usize::MAX
        };
        let tcp = sockets.tcp;
        let threads = vec![
            spawn("app-tcp", &shared, move |s| pump(s, tcp, message_limit))?,
            spawn("app-udp", &shared, move |s| receive(s, &udp))?,
            spawn("app-messenger", &shared, process_received)?,
        ];
        Ok(Self {
            shared,
            udp: sockets.udp,
            threads,
        })
    }

    /// Queues messages for sending.
    pub(super) fn send(&self, messages: Vec<Vec<u8>>) {
        let mut queues = lock(&self.shared.queues);
        (queues.last, queues.answered) = (Some(Instant::now()), false);
        drop(queues);
        lock(&self.shared.out).extend(messages);
    }

    pub(super) fn send_datagram(&self, bytes: &[u8]) -> io::Result<()> {
        lock(&self.shared.replica).wire.datagram_up(bytes);
        self.udp.send(bytes).map(drop)
    }

    /// Waits until an awaited frame ends, or its end is lost.
    ///
    /// Returns an error if the server is silent for [`SERVER_TIMEOUT`].
    pub(super) fn receive(&self, awaited: AwaitedEnd) -> io::Result<()> {
        let mut state = lock(&self.shared.replica);
        while !state.replica.has_ended(awaited) && state.over.is_none() {
            let waited = self.shared.ended.wait_timeout(state, MESSENGER);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
            if !state.replica.has_ended(awaited) && state.over.is_none() {
                let may_lose = state.replica.may_lose(self.shared.buffer_datagrams);
                drop(state);
                let silence = self.shared.silence(may_lose);
                state = lock(&self.shared.replica);
                match silence {
                    Some(Silence::EndLost) => {
                        state.replica.abandon();
                        return Ok(());
                    }
                    Some(Silence::ServerLost) => return Err(io::ErrorKind::TimedOut.into()),
                    None => {}
                }
            }
        }
        match state.over {
            Some(kind) => Err(kind.into()),
            None => Ok(()),
        }
    }

    /// Gives access to the received state, locked against the threads.
    pub(super) fn with<T>(
        &self,
        inspect: impl FnOnce(&mut AppReplica, &mut WireCounter) -> T,
    ) -> T {
        let mut state = lock(&self.shared.replica);
        let ReceivedState { replica, wire, .. } = &mut *state;
        inspect(replica, wire)
    }
}

/// Starts a thread whose failure ends the connection.
fn spawn(
    name: &str,
    shared: &Arc<PolledState>,
    work: impl FnOnce(&PolledState) -> io::Result<()> + Send + 'static,
) -> io::Result<JoinHandle<()>> {
    let shared = Arc::clone(shared);
    thread::Builder::new().name(name.into()).spawn(move || {
        if let Err(cause) = work(&shared) {
            shared.end(cause.kind());
        }
    })
}

/// Interpretation of a long silence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Silence {
    /// The frame ended, but its end message was lost.
    EndLost,
    /// The server no longer responds.
    ServerLost,
}

impl PolledState {
    /// The meaning of the present silence. `None` while messages wait to be sent or processed, or the last one is
    /// recent.
    fn silence(&self, may_lose: bool) -> Option<Silence> {
        if !lock(&self.out).is_empty() {
            return None;
        }
        let queues = lock(&self.queues);
        let idle = queues.tcp.is_empty() && queues.udp.is_empty() && !queues.taking;
        // A server that steps is silent for any length of time. An end counts as lost only after other messages of its
        // frame.
        let (limit, meaning) = if queues.answered && may_lose {
            (END_LOST_AFTER, Silence::EndLost)
        } else {
            (SERVER_TIMEOUT, Silence::ServerLost)
        };
        let long = queues.last.is_some_and(|last| last.elapsed() >= limit);
        (idle && long).then_some(meaning)
    }

    fn is_over(&self) -> bool {
        lock(&self.replica).over.is_some()
    }

    fn end(&self, kind: io::ErrorKind) {
        lock(&self.replica).over.get_or_insert(kind);
        self.ended.notify_all();
    }
}

impl Drop for Polled {
    fn drop(&mut self) {
        self.shared.end(io::ErrorKind::Interrupted);
        for thread in self.threads.drain(..) {
            // A panicking thread has already reported its panic.
            let _ = thread.join();
        }
    }
}

/// Locks a mutex; no thread leaves shared state half updated, so a poisoned lock is safe to use.
fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sends up to `message_limit` messages and reads once, each turn.
fn pump(shared: &PolledState, mut tcp: TcpStream, message_limit: usize) -> io::Result<()> {
    let mut frames = MessageFraming::default();
    let mut buffer = vec![0; READ_BYTES];
    while !shared.is_over() {
        let turn: Vec<Vec<u8>> = {
            let mut out = lock(&shared.out);
            let count = out.len().min(message_limit);
            out.drain(..count).collect()
        };
        tcp.set_nonblocking(false)?;
        for message in &turn {
            tcp.write_all(message)?;
        }
        let sent = turn.concat();
        if !sent.is_empty() {
            lock(&shared.queues).last = Some(Instant::now());
            lock(&shared.replica).wire.segments_up(&sent);
        }
        tcp.set_nonblocking(true)?;
        match tcp.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::ConnectionAborted.into()),
            Ok(count) => {
                lock(&shared.replica).wire.segments_down(&buffer[..count]);
                frames.push(&buffer[..count]);
                let mut queues = lock(&shared.queues);
                queues.last = Some(Instant::now());
                while let Some(message) = next_message(&mut frames)? {
                    queues.tcp.push_back(message);
                }
            }
            Err(cause) if is_nothing_yet(&cause) => {}
            Err(cause) => return Err(cause),
        }
        thread::sleep(PUMP);
    }
    Ok(())
}

fn receive(shared: &PolledState, udp: &UdpSocket) -> io::Result<()> {
    let mut buffer = vec![0; READ_BYTES];
    while !shared.is_over() {
        match udp.recv(&mut buffer) {
            Ok(count) => {
                let datagram = buffer[..count].to_vec();
                let mut queues = lock(&shared.queues);
                (queues.last, queues.answered) = (Some(Instant::now()), true);
                queues.udp.push_back(datagram);
            }
            Err(cause) if is_nothing_yet(&cause) => {}
            Err(cause) => return Err(cause),
        }
    }
    Ok(())
}

/// Processes received messages, TCP first, up to the limit of a turn.
fn process_received(shared: &PolledState) -> io::Result<()> {
    while !shared.is_over() {
        let (tcp, udp): (Vec<Message>, Vec<Vec<u8>>) = {
            let mut queues = lock(&shared.queues);
            let tcp = queues.tcp.len().min(MESSAGES_PER_TURN);
            let udp = queues.udp.len().min(MESSAGES_PER_TURN);
            queues.taking = tcp + udp > 0;
            (
                queues.tcp.drain(..tcp).collect(),
                queues.udp.drain(..udp).collect(),
            )
        };
        if !tcp.is_empty() || !udp.is_empty() {
            let mut state = lock(&shared.replica);
            for message in &tcp {
                state.replica.receive(message);
            }
            for datagram in &udp {
                state.wire.datagram_down(datagram);
                receive_datagram(datagram, &mut state.replica)?;
            }
            drop(state);
            lock(&shared.queues).taking = false;
            shared.ended.notify_all();
        }
        thread::sleep(MESSENGER);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::sync::mpsc;

    use glam::{Quat, Vec3};
    use rhumb_app::{Id, Motion};

    use super::*;
    use crate::drive::app::replica::SIMULATION;
    use crate::drive::remote::Retention;

    const BODIES: u32 = 20;
    /// Silence after which the ends in these tests count as lost.
    const SHORT: Duration = Duration::from_millis(10);

    /// A server's two sockets and a connected client.
    fn ends(defects: Defects, buffer_datagrams: usize) -> (UdpSocket, TcpStream, Direct) {
        let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = tcp.local_addr().unwrap();
        let udp = UdpSocket::bind(address).unwrap();
        let mut sockets = Sockets::open(address, defects).unwrap();
        (sockets.buffer_datagrams, sockets.end_timeout) = (buffer_datagrams, SHORT);
        udp.connect(sockets.udp.local_addr().unwrap()).unwrap();
        let (server, _) = tcp.accept().unwrap();
        (udp, server, Direct::new(sockets, defects).unwrap())
    }

    fn encode(udp: &UdpSocket, message: &Message) {
        let mut bytes = Vec::new();
        message.encode(0, &mut bytes);
        udp.send(&bytes).unwrap();
    }

    /// Sends the states of some bodies, without an end of frame.
    fn send_states(udp: &UdpSocket, objects: std::ops::Range<u32>) {
        for object in objects {
            let actor = Id {
                simulation: SIMULATION,
                object,
            };
            let still = Motion {
                actor,
                position: Vec3::ZERO,
                rotation: Quat::IDENTITY,
                linear: Vec3::ZERO,
                angular: Vec3::ZERO,
                gravity_modifier: 1.0,
            };
            encode(udp, &Message::SetDynamicActor(still));
        }
    }

    fn receiving_end() -> (AppReplica, WireCounter) {
        (
            AppReplica::new(Defects::SOUND),
            WireCounter::new(Retention::Costs),
        )
    }

    #[test]
    fn a_server_that_stalls_within_a_frame_is_waited_for() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, usize::MAX);
        let (requests, requested) = mpsc::channel();
        let server = thread::spawn(move || {
            for () in requested {
                send_states(&udp, 0..BODIES / 2);
                thread::sleep(2 * SHORT);
                send_states(&udp, BODIES / 2..BODIES);
                encode(&udp, &Message::TimeAdvanced(SIMULATION));
            }
        });
        let (mut replica, mut wire) = receiving_end();
        for frame in 1..=3 {
            requests.send(()).unwrap();
            direct.catch_up(&mut replica, &mut wire).unwrap();
            direct.receive(&mut replica, &mut wire).unwrap();
            assert_eq!((replica.ended_frames, replica.lost), (frame, 0));
            assert_eq!(replica.states, frame * u64::from(BODIES));
        }
        drop(requests);
        server.join().unwrap();
    }

    #[test]
    fn a_late_end_is_not_attributed_to_the_next_frame() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, 0);
        let (mut replica, mut wire) = receiving_end();
        send_states(&udp, 0..BODIES);
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.ended_frames, replica.lost), (0, 1));
        // The late end arrives with the next frame, which sends states before its own end.
        encode(&udp, &Message::TimeAdvanced(SIMULATION));
        send_states(&udp, 0..BODIES);
        encode(&udp, &Message::TimeAdvanced(SIMULATION));
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.ended_frames, replica.lost), (1, 1));
        assert_eq!(replica.states, 2 * u64::from(BODIES));
    }

    #[test]
    fn a_lost_end_is_owed_only_until_the_next_frame_ends() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, 0);
        let (mut replica, mut wire) = receiving_end();
        send_states(&udp, 0..BODIES);
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.ended_frames, replica.lost), (0, 1));
        // From here on all bodies sleep, so only the silence after an end tells it from the lost one.
        for frame in 1..=3 {
            encode(&udp, &Message::TimeAdvanced(SIMULATION));
            direct.receive(&mut replica, &mut wire).unwrap();
            assert_eq!((replica.ended_frames, replica.lost), (frame, 1));
        }
    }

    #[test]
    fn a_segment_counts_its_headers_and_its_acknowledgement() {
        let on_wire = |count: Count| count.bytes + 28 * count.packets;
        let mut wire = WireCounter::new(Retention::Everything);
        wire.segments_up(&[0; 32]);
        assert_eq!((on_wire(wire.up), on_wire(wire.down)), (72, 40));
        wire.datagram_down(&[0; 88]);
        assert_eq!(on_wire(wire.down), 40 + 116);
        wire.segments_down(&[0; 3_000]);
        assert_eq!(on_wire(wire.down), 156 + 3_120);
        let taken = wire.take();
        assert_eq!(taken.len(), 3);
        assert!(wire.take().is_empty());
        let mut wire = WireCounter::new(Retention::Costs);
        wire.datagram_down(&[0; 88]);
        assert_eq!((on_wire(wire.down), wire.take().len()), (116, 0));
    }
}
