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

use super::copy::{Awaited, Copy};
use super::line::{
    LOST, MESSAGES_PER_POLL, PUMP, READ_BYTES, Sockets, hear_datagram, is_nothing_yet, next_message,
};
use super::losses::Losses;
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
    shared: Arc<Shared>,
    udp: UdpSocket,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Debug)]
struct Shared {
    /// Messages on their way out.
    out: Mutex<VecDeque<Vec<u8>>>,
    heard: Mutex<Heard>,
    copy: Mutex<Taken>,
    /// A frame is over, or the connection is.
    news: Condvar,
    /// How many datagrams of a state the socket's buffer holds.
    room: usize,
}

/// What was heard and is not taken in yet.
#[derive(Debug, Default)]
struct Heard {
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
struct Taken {
    copy: Copy,
    wire: Wire,
    over: Option<io::ErrorKind>,
}

impl Polled {
    /// Starts the threads.
    pub(super) fn start(
        sockets: Sockets,
        losses: Losses,
        copy: Copy,
        wire: Wire,
    ) -> io::Result<Self> {
        let shared = Arc::new(Shared {
            out: Mutex::default(),
            heard: Mutex::default(),
            copy: Mutex::new(Taken {
                copy,
                wire,
                over: None,
            }),
            news: Condvar::new(),
            room: sockets.room,
        });
        let udp = sockets.udp.try_clone()?;
        udp.set_read_timeout(Some(LOOK))?;
        let most = if losses.cap {
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
        let mut heard = lock(&self.shared.heard);
        (heard.last, heard.answered) = (Some(Instant::now()), false);
        drop(heard);
        lock(&self.shared.out).extend(messages);
    }

    pub(super) fn send_datagram(&self, bytes: &[u8]) -> io::Result<()> {
        lock(&self.shared.copy).wire.datagram_up(bytes);
        self.udp.send(bytes).map(drop)
    }

    /// Waits until an awaited frame is over, or its end is lost.
    ///
    /// Errors when a server says nothing of a frame for [`PATIENCE`].
    pub(super) fn hear(&self, awaited: Awaited) -> io::Result<()> {
        let mut taken = lock(&self.shared.copy);
        while !taken.copy.has_ended(awaited) && taken.over.is_none() {
            let waited = self.shared.news.wait_timeout(taken, MESSENGER);
            taken = waited.unwrap_or_else(PoisonError::into_inner).0;
            if !taken.copy.has_ended(awaited) && taken.over.is_none() {
                let may_lose = taken.copy.may_lose(self.shared.room);
                drop(taken);
                let silence = self.shared.silence(may_lose);
                taken = lock(&self.shared.copy);
                match silence {
                    Some(Silence::EndLost) => {
                        taken.copy.give_up();
                        return Ok(());
                    }
                    Some(Silence::Gone) => return Err(io::ErrorKind::TimedOut.into()),
                    None => {}
                }
            }
        }
        match taken.over {
            Some(kind) => Err(kind.into()),
            None => Ok(()),
        }
    }

    /// Looks at what was taken in, while no thread does.
    pub(super) fn with<T>(&self, look: impl FnOnce(&mut Copy, &mut Wire) -> T) -> T {
        let mut taken = lock(&self.shared.copy);
        let Taken { copy, wire, .. } = &mut *taken;
        look(copy, wire)
    }
}

/// Starts a thread whose failure ends the connection.
fn spawn(
    name: &str,
    shared: &Arc<Shared>,
    work: impl FnOnce(&Shared) -> io::Result<()> + Send + 'static,
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

impl Shared {
    /// What it means that all that was to be said has left, all that came is taken in, and that was long ago; `None` while
    /// that is not so.
    fn silence(&self, may_lose: bool) -> Option<Silence> {
        if !lock(&self.out).is_empty() {
            return None;
        }
        let heard = lock(&self.heard);
        let idle = heard.tcp.is_empty() && heard.udp.is_empty() && !heard.taking;
        // A server that steps is silent, however long it takes: an end is lost only behind what came before it.
        let (most, meaning) = if heard.answered && may_lose {
            (LOST, Silence::EndLost)
        } else {
            (PATIENCE, Silence::Gone)
        };
        let long = heard.last.is_some_and(|last| last.elapsed() >= most);
        (idle && long).then_some(meaning)
    }

    fn is_over(&self) -> bool {
        lock(&self.copy).over.is_some()
    }

    fn end(&self, kind: io::ErrorKind) {
        lock(&self.copy).over.get_or_insert(kind);
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
fn pump(shared: &Shared, mut tcp: TcpStream, most: usize) -> io::Result<()> {
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
            lock(&shared.heard).last = Some(Instant::now());
            lock(&shared.copy).wire.segments_up(&sent);
        }
        tcp.set_nonblocking(true)?;
        match tcp.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::ConnectionAborted.into()),
            Ok(count) => {
                lock(&shared.copy).wire.segments_down(&buffer[..count]);
                frames.push(&buffer[..count]);
                let mut heard = lock(&shared.heard);
                heard.last = Some(Instant::now());
                while let Some(message) = next_message(&mut frames)? {
                    heard.tcp.push_back(message);
                }
            }
            Err(cause) if is_nothing_yet(&cause) => {}
            Err(cause) => return Err(cause),
        }
        thread::sleep(PUMP);
    }
    Ok(())
}

fn receive(shared: &Shared, udp: &UdpSocket) -> io::Result<()> {
    let mut buffer = vec![0; READ_BYTES];
    while !shared.is_over() {
        match udp.recv(&mut buffer) {
            Ok(count) => {
                let datagram = buffer[..count].to_vec();
                let mut heard = lock(&shared.heard);
                (heard.last, heard.answered) = (Some(Instant::now()), true);
                heard.udp.push_back(datagram);
            }
            Err(cause) if is_nothing_yet(&cause) => {}
            Err(cause) => return Err(cause),
        }
    }
    Ok(())
}

/// Takes in what was heard, TCP first, as much as one turn takes.
fn take_in(shared: &Shared) -> io::Result<()> {
    while !shared.is_over() {
        let (tcp, udp): (Vec<Message>, Vec<Vec<u8>>) = {
            let mut heard = lock(&shared.heard);
            let tcp = heard.tcp.len().min(MESSAGES_PER_TURN);
            let udp = heard.udp.len().min(MESSAGES_PER_TURN);
            heard.taking = tcp + udp > 0;
            (
                heard.tcp.drain(..tcp).collect(),
                heard.udp.drain(..udp).collect(),
            )
        };
        if !tcp.is_empty() || !udp.is_empty() {
            let mut taken = lock(&shared.copy);
            for message in &tcp {
                taken.copy.hear(message);
            }
            for datagram in &udp {
                taken.wire.datagram_down(datagram);
                hear_datagram(datagram, &mut taken.copy)?;
            }
            drop(taken);
            lock(&shared.heard).taking = false;
            shared.news.notify_all();
        }
        thread::sleep(MESSENGER);
    }
    Ok(())
}
