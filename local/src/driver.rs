//! The server side: inputs of clients, timeouts, transmissions.
//!
//! Runs on whichever thread calls it. It neither waits nor sleeps. A panic of the server ends its connections, and
//! never reaches a caller.

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Peer, Transmit};
use rhumb_server::Front;
use rhumb_transport::{Clock, HeldBack, Inbox};

/// One input of a client.
#[derive(Debug)]
pub(crate) enum LocalInput {
    Opened(Arc<Inbox>),
    Control(Bytes),
    /// The client has taken so many control bytes out of its inbox.
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
    pub(crate) const fn is_refusable(&self) -> bool {
        matches!(self, Self::Control(_) | Self::State(_))
    }
}

/// A server, and the inboxes of its clients.
pub(crate) struct Driver {
    front: Front,
    clock: Clock,
    inboxes: BTreeMap<Peer, Arc<Inbox>>,
    held_back: HeldBack<Bytes>,
    /// True after a panic: the front is in an unknown state, and is not called again.
    broken: bool,
}

impl Driver {
    pub(crate) fn new(front: Front, clock: Clock) -> Self {
        Self {
            front,
            clock,
            inboxes: BTreeMap::new(),
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

    /// Does what is due, and hands out what the server transmits. Returns the time until more is due, if it will be
    /// without an input.
    pub(crate) fn run(&mut self) -> Option<Duration> {
        self.guard(Self::turn).flatten()
    }

    /// Calls the front, unless it has panicked, in this call or before.
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
                self.inboxes.insert(from, inbox);
                self.front.handle_opened(now, from);
                self.front.handle_control_taken(now, from, 0);
            }
            LocalInput::Control(bytes) => {
                (self.held_back).handle_control(now, &mut self.front, from, bytes);
            }
            LocalInput::Taken(bytes) => self.front.handle_control_taken(now, from, bytes),
            LocalInput::State(bytes) => self.front.handle_datagram(now, from, &bytes),
            LocalInput::Closed(code) => {
                if let Some(inbox) = self.inboxes.remove(&from) {
                    (self.held_back).deliver_rest(now, &mut self.front, from);
                    inbox.put_end(Ending::Closed(code));
                    self.front.handle_ended(now, from, Ending::Closed(code));
                }
            }
        }
    }

    fn turn(&mut self) -> Option<Duration> {
        let now = self.clock.now();
        if self.front.poll_timeout().is_some_and(|wake| wake.at <= now) {
            self.front.handle_timeout(now);
        }
        self.transmit();
        while self.held_back.deliver(now, &mut self.front) {
            self.transmit();
        }
        let wake = self.front.poll_timeout()?;
        Some(self.clock.until(wake.at))
    }

    fn end(&mut self) {
        for inbox in std::mem::take(&mut self.inboxes).into_values() {
            inbox.put_end(Ending::Broken);
        }
    }

    fn transmit(&mut self) {
        while let Some(transmit) = self.front.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    if let Some(inbox) = self.inboxes.get(&to) {
                        inbox.put_bounded_control(&bytes);
                    }
                }
                Transmit::State { to, bytes } => {
                    if let Some(inbox) = self.inboxes.get(&to) {
                        inbox.put_state(&bytes);
                    }
                }
                Transmit::Close { to, code } => {
                    let now = self.clock.now();
                    if let Some(inbox) = self.inboxes.remove(&to) {
                        self.held_back.forget(to);
                        inbox.put_end(Ending::Closed(code));
                        self.front.handle_ended(now, to, Ending::Closed(code));
                    }
                }
            }
        }
    }
}
