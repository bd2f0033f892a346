//! The way of a client's inputs to the server: a call or a queue.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};

use rhumb_protocol::Peer;

use crate::driver::{Driver, LocalInput};

/// Bytes that may wait for the server's thread, from all clients.
const WAITING_BYTES_MAX: usize = 64 << 20;
/// Cost of a waiting input beside its bytes.
const INPUT_COST_BYTES: usize = 64;

/// The thread on which a server runs.
#[derive(Clone)]
pub(crate) enum Host {
    /// That of each client's call.
    Caller(Arc<Mutex<Driver>>),
    /// One of its own.
    Thread(InputQueue),
}

/// Inputs that wait for the server's thread.
#[derive(Clone)]
pub(crate) struct InputQueue {
    sender: Sender<QueuedInput>,
    waiting: Arc<AtomicUsize>,
}

/// One waiting input.
pub(crate) struct QueuedInput {
    from: Peer,
    input: LocalInput,
    waiting: Arc<AtomicUsize>,
}

/// An input could not be handed over: the server is gone, or too much waits for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Lost {
    Server,
    Full,
}

impl Host {
    /// Hands over an input. A server on the caller's thread has handled it when this returns.
    pub(crate) fn send(&self, from: Peer, input: LocalInput) -> Result<(), Lost> {
        match self {
            Self::Caller(driver) => {
                // No panic leaves the driver.
                let mut driver = driver.lock().map_err(|_| Lost::Server)?;
                driver.handle(from, input);
                Ok(())
            }
            Self::Thread(queue) => queue.send(from, input),
        }
    }
}

impl InputQueue {
    pub(crate) fn new(sender: Sender<QueuedInput>) -> Self {
        Self {
            sender,
            waiting: Arc::default(),
        }
    }

    fn send(&self, from: Peer, input: LocalInput) -> Result<(), Lost> {
        let cost = cost(&input);
        if self.waiting.load(Ordering::Relaxed) + cost > WAITING_BYTES_MAX && input.is_refusable() {
            return Err(Lost::Full);
        }
        self.waiting.fetch_add(cost, Ordering::Relaxed);
        let waiting = Arc::clone(&self.waiting);
        let message = QueuedInput {
            from,
            input,
            waiting,
        };
        self.sender.send(message).map_err(|_| Lost::Server)
    }
}

impl QueuedInput {
    /// Handles the input in the server.
    pub(crate) fn handle(self, driver: &mut Driver) {
        self.waiting.fetch_sub(cost(&self.input), Ordering::Relaxed);
        driver.handle(self.from, self.input);
    }
}

fn cost(input: &LocalInput) -> usize {
    INPUT_COST_BYTES + input.bytes()
}
