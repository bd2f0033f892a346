//! The server side: inputs of clients, timeouts, transmissions.
//!
//! Runs on whichever thread calls it. It neither waits nor sleeps. A panic of the server ends its connections, and
//! never reaches a caller. A client's inputs arrive by a call or a queue.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use bytes::Bytes;
use rhumb_link::{Clock, HeldBack, Inbox};
use rhumb_protocol::{Ending, Endpoint, Peer, Transmit};
use rhumb_scene::ServerLoop;

/// One input of a client.
#[derive(Debug)]
pub(crate) enum LocalInput {
    Opened(Arc<Inbox>),
    Control(Bytes),
    /// The client has taken this number of control bytes out of its inbox.
    Taken(usize),
    State(Bytes),
    /// The client has closed its connection, with this code.
    Closed(u32),
}

impl LocalInput {
    /// Its bytes.
    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Control(bytes) | Self::State(bytes) => bytes.len(),
            Self::Opened(_) | Self::Taken(_) | Self::Closed(_) => 0,
        }
    }

    /// True if a full queue refuses it: a client sends any number of them.
    const fn is_refusable(&self) -> bool {
        matches!(self, Self::Control(_) | Self::State(_))
    }
}

/// A server, and the inboxes of its clients.
pub(crate) struct Driver {
    server: ServerLoop,
    clock: Clock,
    clients: BTreeMap<Peer, LocalClient>,
    held_back: HeldBack<Bytes>,
    /// True after a panic: the server is in an unknown state, and is not called again.
    broken: bool,
}

/// The inbox of a client, and its control bytes.
struct LocalClient {
    inbox: Arc<Inbox>,
    /// Bytes that wait in the inbox.
    waiting: usize,
    /// Taken bytes that the server does not know of yet.
    unreported: usize,
}

/// Control bytes that count as taken while they wait in an inbox. A client that is not polled for minutes stays, as one
/// behind a socket does, whose thread reads for it.
const TAKEN_BYTES_MAX: usize = 1 << 20;

impl LocalClient {
    /// Puts control bytes into the inbox; returns how many count as taken.
    fn put(&mut self, bytes: &Bytes) -> usize {
        self.inbox.put_bounded_control(bytes);
        self.waiting += bytes.len();
        if self.waiting > TAKEN_BYTES_MAX {
            self.unreported += bytes.len();
            return 0;
        }
        bytes.len()
    }

    /// Notes that the client has taken bytes; returns how many the server does not know of.
    fn take(&mut self, bytes: usize) -> usize {
        self.waiting = self.waiting.saturating_sub(bytes);
        let news = bytes.min(self.unreported);
        self.unreported -= news;
        news
    }
}

impl Driver {
    pub(crate) fn new(server: ServerLoop, clock: Clock) -> Self {
        Self {
            server,
            clock,
            clients: BTreeMap::new(),
            held_back: HeldBack::default(),
            broken: false,
        }
    }

    /// Hands an input to the server. What it transmits waits for [`Self::run`].
    pub(crate) fn handle(&mut self, from: Peer, input: LocalInput) {
        if self.broken
            && let LocalInput::Opened(inbox) = &input
        {
            inbox.put_end(Ending::Broken);
        }
        self.guard(|driver| driver.take(from, input));
    }

    /// Runs all due work, and delivers the transmissions of the server. Returns the time until the next timeout, if the
    /// server has one.
    pub(crate) fn run(&mut self) -> Option<Duration> {
        self.guard(Self::turn).flatten()
    }

    /// Calls the server, unless it has panicked, in this call or before.
    fn guard<T>(&mut self, call: impl FnOnce(&mut Self) -> T) -> Option<T> {
        if self.broken {
            return None;
        }
        let called = catch_unwind(AssertUnwindSafe(|| call(self)));
        if called.is_err() {
            tracing::error!("the server in this process panicked");
            self.broken = true;
            self.end();
        }
        called.ok()
    }

    fn take(&mut self, from: Peer, input: LocalInput) {
        let now = self.clock.now();
        match input {
            LocalInput::Opened(inbox) => {
                let client = LocalClient {
                    inbox,
                    waiting: 0,
                    unreported: 0,
                };
                self.clients.insert(from, client);
                self.server.handle_opened(now, from);
                self.server.handle_control_taken(now, from, 0);
            }
            LocalInput::Control(bytes) => {
                (self.held_back).handle_control(now, &mut self.server, from, bytes);
            }
            LocalInput::Taken(bytes) => {
                let news = self.clients.get_mut(&from).map(|client| client.take(bytes));
                if let Some(news) = news.filter(|news| *news > 0) {
                    self.server.handle_control_taken(now, from, news);
                }
            }
            LocalInput::State(bytes) => self.server.handle_datagram(now, from, &bytes),
            LocalInput::Closed(code) => {
                if let Some(client) = self.clients.remove(&from) {
                    (self.held_back).deliver_rest(now, &mut self.server, from);
                    client.inbox.put_end(Ending::Closed(code));
                    self.server.handle_ended(now, from, Ending::Closed(code));
                }
            }
        }
    }

    fn turn(&mut self) -> Option<Duration> {
        let now = self.clock.now();
        if self
            .server
            .poll_timeout()
            .is_some_and(|wake| wake.at <= now)
        {
            self.server.handle_timeout(now);
        }
        self.transmit();
        while self.held_back.deliver(now, &mut self.server) {
            self.transmit();
        }
        let wake = self.server.poll_timeout()?;
        Some(self.clock.until(wake.at))
    }

    fn end(&mut self) {
        for client in std::mem::take(&mut self.clients).into_values() {
            client.inbox.put_end(Ending::Broken);
        }
    }

    fn transmit(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    let taken = self.clients.get_mut(&to).map(|client| client.put(&bytes));
                    if let Some(taken) = taken.filter(|taken| *taken > 0) {
                        let now = self.clock.now();
                        self.server.handle_control_taken(now, to, taken);
                    }
                }
                Transmit::State { to, bytes } => {
                    if let Some(client) = self.clients.get(&to) {
                        client.inbox.put_state(&bytes);
                    }
                }
                Transmit::Close { to, code } => {
                    let now = self.clock.now();
                    if let Some(client) = self.clients.remove(&to) {
                        self.held_back.forget(to);
                        client.inbox.put_end(Ending::Closed(code));
                        self.server.handle_ended(now, to, Ending::Closed(code));
                    }
                }
            }
        }
    }
}

/// Bytes that may wait for the server's thread, from all clients.
const WAITING_BYTES_MAX: usize = 64 << 20;
/// Cost of a waiting input beside its bytes.
const INPUT_COST_BYTES: usize = 64;

/// The thread on which a server runs.
#[derive(Clone)]
pub(crate) enum Host {
    /// The thread of each client's call.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_for_a_client_that_does_not_poll_count_as_taken_up_to_a_bound() {
        let mut client = LocalClient {
            inbox: Arc::default(),
            waiting: 0,
            unreported: 0,
        };
        let half = Bytes::from(vec![0; TAKEN_BYTES_MAX / 2]);
        let puts = [client.put(&half), client.put(&half), client.put(&half)];
        assert_eq!(puts, [half.len(), half.len(), 0]);
        // The client takes the first piece: those bytes were counted, so others count for them.
        assert_eq!(client.take(half.len()), half.len());
        assert_eq!(client.take(half.len()), 0);
        assert_eq!(client.put(&half), half.len());
    }
}
