//! A server in this process, and the two ways to run it.

use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex};
use std::thread;

use rhumb_client::ServerConnection;
use rhumb_protocol::Peer;
use rhumb_server::Front;
use rhumb_transport::Clock;

use crate::connection::LocalConnection;
use crate::driver::Driver;
use crate::host::{Host, InputQueue, QueuedInput};

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
        Self::of(front())
    }

    /// A server that steps on a thread of its own, with the default limits.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn() -> io::Result<Self> {
        Self::spawn_of(front())
    }

    /// As [`Self::new`], with hooks, limits and threads of the engine as this front has them.
    #[must_use]
    pub fn of(front: Front) -> Self {
        let driver = Driver::new(front, Clock::start());
        Self::at(Host::Caller(Arc::new(Mutex::new(driver))))
    }

    /// As [`Self::spawn`], with hooks, limits and threads of the engine as this front has them.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn spawn_of(front: Front) -> io::Result<Self> {
        let (sender, inputs) = channel();
        let mut driver = Driver::new(front, Clock::start());
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

fn front() -> Front {
    let stopwatch = Clock::start();
    Front::on_one_thread(move || stopwatch.now())
}

/// Runs a server until nothing can reach it any more.
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
