//! The threads of the published client, which poll for work.
//!
//! Three threads, as in the original. One pumps TCP every 30 ms, out and in. One reads datagrams as they arrive. One
//! processes received messages every 10 ms, 5,000 of each transport. No order holds across them.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use std::{io, thread};

use rhumb_app::{Message, MessageFraming};

use super::replica::{AppReplica, AwaitedEnd, Defects};
use super::sockets::{
    END_LOST_AFTER, MESSAGES_PER_POLL, PUMP, READ_BYTES, Sockets, WireCounter, is_nothing_yet,
    next_message, receive_datagram,
};
use crate::drive::process::SERVER_TIMEOUT;

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
