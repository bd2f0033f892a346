//! The threads of the published client, which look for work now and then.
//!
//! Three, as it has them: one pumps TCP each 30 ms, out and in; one reads datagrams as they come; one takes in each 10 ms
//! what both have heard, 5,000 messages of each. No order across them.

use std::collections::VecDeque;
use std::io::{self, Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use rhumb_app::{Frames, Message};

use super::defects::Defects;
use super::replica::{AppReplica, Awaited};
use super::sockets::{
    LOST, MESSAGES_PER_POLL, PUMP, READ_BYTES, Sockets, is_nothing_yet, next_message,
    receive_datagram,
};
use super::wire::Wire;
use crate::drive::PATIENCE;

/// Between two turns of the thread that takes in what was heard.
const MESSENGER: Duration = Duration::from_millis(10);
/// Messages of each transport that it takes in in one turn.
const MESSAGES_PER_TURN: usize = 5_000;
/// How long a thread waits for a datagram before it looks whether it is to end.
const LOOK: Duration = Duration::from_millis(50);

/// A connection that threads read.
#[derive(Debug)]
pub(super) struct Polled {
    shared: Arc<PolledState>,
    udp: UdpSocket,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct PolledState {
    /// Messages on their way out.
    out: Mutex<VecDeque<Vec<u8>>>,
    queues: Mutex<ReceiveQueues>,
    replica: Mutex<ReceivedState>,
    /// A frame is over, or the connection is.
    news: Condvar,
    /// How many datagrams of a state the socket's buffer holds.
    room: usize,
}

/// What was heard and is not taken in yet.
#[derive(Debug, Default)]
struct ReceiveQueues {
    tcp: VecDeque<Message>,
    udp: VecDeque<Vec<u8>>,
    /// When anything came or left last.
    last: Option<Instant>,
    /// Whether anything came since something was to leave last.
    answered: bool,
    /// Whether some of it is being taken in.
    taking: bool,
}

/// What was taken in.
#[derive(Debug)]
struct ReceivedState {
    replica: AppReplica,
    wire: Wire,
    over: Option<io::ErrorKind>,
}

impl Polled {
    /// Starts the threads.
    pub(super) fn start(
        sockets: Sockets,
        defects: Defects,
        replica: AppReplica,
        wire: Wire,
    ) -> io::Result<Self> {
        let shared = Arc::new(PolledState {
            out: Mutex::default(),
            queues: Mutex::default(),
            replica: Mutex::new(ReceivedState {
                replica,
                wire,
                over: None,
            }),
            news: Condvar::new(),
            room: sockets.room,
        });
        let udp = sockets.udp.try_clone()?;
        udp.set_read_timeout(Some(LOOK))?;
        let most = if defects.cap {
            MESSAGES_PER_POLL
        } else {
            usize::MAX
        };
        let tcp = sockets.tcp;
        let threads = vec![
            spawn("app-tcp", &shared, move |s| pump(s, tcp, most))?,
            spawn("app-udp", &shared, move |s| receive(s, &udp))?,
            spawn("app-messenger", &shared, take_in)?,
        ];
        Ok(Self {
            shared,
            udp: sockets.udp,
            threads,
        })
    }

    /// Queues messages.
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

    /// Waits until an awaited frame is over, or its end is lost.
    ///
    /// Errors when a server says nothing of a frame for [`PATIENCE`].
    pub(super) fn receive(&self, awaited: Awaited) -> io::Result<()> {
        let mut state = lock(&self.shared.replica);
        while !state.replica.has_ended(awaited) && state.over.is_none() {
            let waited = self.shared.news.wait_timeout(state, MESSENGER);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
            if !state.replica.has_ended(awaited) && state.over.is_none() {
                let may_lose = state.replica.may_lose(self.shared.room);
                drop(state);
                let silence = self.shared.silence(may_lose);
                state = lock(&self.shared.replica);
                match silence {
                    Some(Silence::EndLost) => {
                        state.replica.give_up();
                        return Ok(());
                    }
                    Some(Silence::Gone) => return Err(io::ErrorKind::TimedOut.into()),
                    None => {}
                }
            }
        }
        match state.over {
            Some(kind) => Err(kind.into()),
            None => Ok(()),
        }
    }

    /// Looks at what was taken in, while no thread does.
    pub(super) fn with<T>(&self, look: impl FnOnce(&mut AppReplica, &mut Wire) -> T) -> T {
        let mut state = lock(&self.shared.replica);
        let ReceivedState { replica, wire, .. } = &mut *state;
        look(replica, wire)
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

/// What a long silence is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Silence {
    /// The frame is over, and the word for that was lost.
    EndLost,
    /// The server is.
    Gone,
}

impl PolledState {
    /// What it means that all that was to be said has left, all that came is taken in, and that was long ago; `None` while
    /// that is not so.
    fn silence(&self, may_lose: bool) -> Option<Silence> {
        if !lock(&self.out).is_empty() {
            return None;
        }
        let queues = lock(&self.queues);
        let idle = queues.tcp.is_empty() && queues.udp.is_empty() && !queues.taking;
        // A server that steps is silent, however long it takes: an end is lost only behind what came before it.
        let (most, meaning) = if queues.answered && may_lose {
            (LOST, Silence::EndLost)
        } else {
            (PATIENCE, Silence::Gone)
        };
        let long = queues.last.is_some_and(|last| last.elapsed() >= most);
        (idle && long).then_some(meaning)
    }

    fn is_over(&self) -> bool {
        lock(&self.replica).over.is_some()
    }

    fn end(&self, kind: io::ErrorKind) {
        lock(&self.replica).over.get_or_insert(kind);
        self.news.notify_all();
    }
}

impl Drop for Polled {
    fn drop(&mut self) {
        self.shared.end(io::ErrorKind::Interrupted);
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so.
            let _ = thread.join();
        }
    }
}

/// Nothing that any of these threads holds is left half done by a panic of another.
fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// So many messages out and one read in, each turn.
fn pump(shared: &PolledState, mut tcp: TcpStream, most: usize) -> io::Result<()> {
    let mut frames = Frames::default();
    let mut buffer = vec![0; READ_BYTES];
    while !shared.is_over() {
        let turn: Vec<Vec<u8>> = {
            let mut out = lock(&shared.out);
            let count = out.len().min(most);
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

/// Takes in what was heard, TCP first, as much as one turn takes.
fn take_in(shared: &PolledState) -> io::Result<()> {
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
            shared.news.notify_all();
        }
        thread::sleep(MESSENGER);
    }
    Ok(())
}
