//! A server in this process, its clients' connections, the two ways to run it.
//!
//! Opens no socket. A call steps the server, or a thread of its own does.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use std::{io, thread};

use bytes::Bytes;
use rhumb_client::{
    ClientTransport, Ending, Received, ServerConnection, TransportCode, WireStatistics,
};
use rhumb_link::{Clock, Inbox};
use rhumb_protocol::{Peer, Span};
use rhumb_scene::ServerLoop;

use crate::driver::{Driver, Host, InputQueue, LocalInput, Lost, QueuedInput};

/// Inputs that the server's thread handles before outputs and ticks get their turn.
const INPUTS_PER_TURN: usize = 256;
/// Stack of the server's thread: what a main thread has.
const STACK_BYTES: usize = 8 << 20;

/// A physics server in this process.
///
/// Clones are one server. It ends with the last of them and of its clients.
#[derive(Clone)]
pub struct LocalServer {
    host: Host,
    next_peer: Arc<AtomicU64>,
}

impl LocalServer {
    /// A server that steps on the thread of the client that calls it, with the default limits.
    #[must_use]
    pub fn new() -> Self {
        Self::of(scenes())
    }

    /// A server that steps on a thread of its own, with the default limits.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn() -> io::Result<Self> {
        Self::spawn_of(scenes())
    }

    /// As [`Self::new`], with hooks, limits and threads of the engine as these scenes have them.
    #[must_use]
    pub fn of(scenes: ServerLoop) -> Self {
        let driver = Driver::new(scenes, Clock::start());
        Self::at(Host::Caller(Arc::new(Mutex::new(driver))))
    }

    /// As [`Self::spawn`], with hooks, limits and threads of the engine as these scenes have them.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn_of(scenes: ServerLoop) -> io::Result<Self> {
        let (sender, inputs) = channel();
        let mut driver = Driver::new(scenes, Clock::start());
        thread::Builder::new()
            .name("rhumb-local-server".to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || run(&mut driver, &inputs))?;
        Ok(Self::at(Host::Thread(InputQueue::new(sender))))
    }

    /// Connects a client. The connection waits for no socket and cannot fail.
    #[must_use]
    pub fn connect(&self) -> ServerConnection {
        let peer = Peer(self.next_peer.fetch_add(1, Ordering::Relaxed));
        ServerConnection::over(LocalConnection::open(self.host.clone(), peer))
    }

    fn at(host: Host) -> Self {
        Self {
            host,
            next_peer: Arc::default(),
        }
    }
}

impl Default for LocalServer {
    fn default() -> Self {
        Self::new()
    }
}

fn scenes() -> ServerLoop {
    let stopwatch = Clock::start();
    ServerLoop::new(move || stopwatch.now())
}

/// Runs a server until its last client is gone.
fn run(driver: &mut Driver, inputs: &Receiver<QueuedInput>) {
    loop {
        let first = match driver.run() {
            None => inputs.recv().map_err(|_| RecvTimeoutError::Disconnected),
            Some(left) => inputs.recv_timeout(left),
        };
        match first {
            Ok(first) => {
                first.handle(driver);
                for message in inputs.try_iter().take(INPUTS_PER_TURN) {
                    message.handle(driver);
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Longest sleep of a client whose server runs on the threads of its clients: another client's call may have brought
/// the server's next moment forward.
const NAP: Duration = Duration::from_millis(5);

/// An open connection of a client to a server in this process.
struct LocalConnection {
    host: Host,
    peer: Peer,
    inbox: Arc<Inbox>,
    clock: Clock,
    sent: Traffic,
    received: Traffic,
}

/// Bytes and pieces, without headers: there are none.
#[derive(Default)]
struct Traffic {
    bytes: AtomicU64,
    pieces: AtomicU64,
}

impl LocalConnection {
    fn open(host: Host, peer: Peer) -> Self {
        let connection = Self {
            host,
            peer,
            inbox: Arc::default(),
            clock: Clock::start(),
            sent: Traffic::default(),
            received: Traffic::default(),
        };
        connection.send(LocalInput::Opened(Arc::clone(&connection.inbox)));
        connection
    }

    /// Hands an input to the server; without one, the connection has ended.
    fn send(&self, input: LocalInput) {
        let ending = match self.host.send(self.peer, input) {
            Ok(()) => return,
            Err(Lost::Server) => Ending::Broken,
            Err(Lost::Full) => {
                let code = TransportCode::CONTROL_OVERFLOW.0;
                // If the server is gone, the connection ends below all the same.
                let _ = self.host.send(self.peer, LocalInput::Closed(code));
                Ending::Closed(code)
            }
        };
        self.inbox.put_end(ending);
    }

    /// Runs a server on this thread as far as is due; returns how long a wait may last.
    fn run_server(&self) -> Duration {
        let Host::Caller(driver) = &self.host else {
            return Duration::MAX;
        };
        match driver.lock() {
            Ok(mut driver) => driver.run().map_or(NAP, |left| left.min(NAP)),
            Err(_) => {
                self.inbox.put_end(Ending::Broken);
                Duration::ZERO
            }
        }
    }
}

impl ClientTransport for LocalConnection {
    fn send_control(&self, bytes: Bytes) {
        self.sent.add(bytes.len());
        self.send(LocalInput::Control(bytes));
    }

    fn send_state(&self, bytes: Bytes) {
        self.sent.add(bytes.len());
        // As on a network, a datagram that cannot be kept is lost.
        if self.host.send(self.peer, LocalInput::State(bytes)) == Err(Lost::Server) {
            self.inbox.put_end(Ending::Broken);
        }
    }

    fn close(&self, code: u32) {
        self.send(LocalInput::Closed(code));
    }

    fn recv(&mut self, timeout: Duration) -> Option<Received> {
        let timeout = Span::from_nanos(u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX));
        let until = self.clock.now() + timeout;
        let received = loop {
            let pause = self.run_server();
            let left = self.clock.until(until);
            match self.inbox.take(pause.min(left)) {
                Some(received) => break received,
                None if left.is_zero() || self.inbox.has_ended() => return None,
                None => {}
            }
        };
        match &received {
            Received::Control(bytes) => {
                self.received.add(bytes.len());
                self.send(LocalInput::Taken(bytes.len()));
            }
            Received::State(bytes) => self.received.add(bytes.len()),
            Received::Ended(_) => {}
        }
        Some(received)
    }

    fn statistics(&self) -> WireStatistics {
        WireStatistics {
            sent_bytes: self.sent.bytes.load(Ordering::Relaxed),
            sent_datagrams: self.sent.pieces.load(Ordering::Relaxed),
            received_bytes: self.received.bytes.load(Ordering::Relaxed),
            received_datagrams: self.received.pieces.load(Ordering::Relaxed),
            ..WireStatistics::default()
        }
    }
}

impl Drop for LocalConnection {
    fn drop(&mut self) {
        self.inbox.abandon();
        // A server that is gone needs no word of it.
        let _ = (self.host).send(self.peer, LocalInput::Closed(TransportCode::LEFT.0));
    }
}

impl Traffic {
    fn add(&self, bytes: usize) {
        self.bytes.fetch_add(bytes as u64, Ordering::Relaxed);
        self.pieces.fetch_add(1, Ordering::Relaxed);
    }
}
