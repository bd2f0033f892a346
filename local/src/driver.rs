//! The server side: inputs of the clients, timeouts, transmissions into their inboxes.
//!
//! Runs on whichever thread calls it. It neither waits nor sleeps. A panic of the server ends its connections, and
//! never reaches a caller.

use std::collections::{BTreeMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Peer, Transmit};
use rhumb_server::Front;
use rhumb_transport::{Clock, Inbox};

/// One input of a client.
#[derive(Debug)]
pub(crate) enum Input {
    Opened(Arc<Inbox>),
    Control(Bytes),
    /// The client has taken so many control bytes out of its inbox.
    Taken(usize),
    State(Bytes),
    /// The client has closed its connection, with this code.
    Closed(u32),
}

impl Input {
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
    peers: BTreeMap<Peer, LocalPeer>,
    /// True after a panic: the front is in an unknown state, and is not called again.
    broken: bool,
}

struct LocalPeer {
    inbox: Arc<Inbox>,
    /// Control bytes that the server does not want yet.
    held_back: VecDeque<Bytes>,
}

impl Driver {
    pub(crate) const fn new(front: Front, clock: Clock) -> Self {
        Self {
            front,
            clock,
            peers: BTreeMap::new(),
            broken: false,
        }
    }

    /// Hands an input to the server. What it transmits waits for [`Self::run`].
    pub(crate) fn handle(&mut self, from: Peer, input: Input) {
        if self.broken
            && let Input::Opened(inbox) = &input
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

    fn take(&mut self, from: Peer, input: Input) {
        let now = self.clock.now();
        match input {
            Input::Opened(inbox) => {
                let held_back = VecDeque::new();
                self.peers.insert(from, LocalPeer { inbox, held_back });
                self.front.handle_opened(now, from);
                self.front.handle_control_taken(now, from, 0);
            }
            Input::Control(bytes) => {
                let Some(peer) = self.peers.get_mut(&from) else {
                    return;
                };
                if peer.held_back.is_empty() && self.front.wants_control(from) {
                    self.front.handle_control(now, from, &bytes);
                } else {
                    peer.held_back.push_back(bytes);
                }
            }
            Input::Taken(bytes) => self.front.handle_control_taken(now, from, bytes),
            Input::State(bytes) => self.front.handle_datagram(now, from, &bytes),
            Input::Closed(code) => {
                if let Some(peer) = self.peers.remove(&from) {
                    for bytes in peer.held_back {
                        self.front.handle_control(now, from, &bytes);
                    }
                    peer.inbox.put_end(Ending::Closed(code));
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
        while self.deliver() {
            self.transmit();
        }
        let wake = self.front.poll_timeout()?;
        Some(self.clock.until(wake.at))
    }

    fn end(&mut self) {
        for peer in std::mem::take(&mut self.peers).into_values() {
            peer.inbox.put_end(Ending::Broken);
        }
    }

    fn transmit(&mut self) {
        while let Some(transmit) = self.front.poll_transmit() {
            match transmit {
                Transmit::Control { to, bytes } => {
                    if let Some(peer) = self.peers.get(&to) {
                        peer.inbox.put_bounded_control(&bytes);
                    }
                }
                Transmit::State { to, bytes } => {
                    if let Some(peer) = self.peers.get(&to) {
                        peer.inbox.put_state(&bytes);
                    }
                }
                Transmit::Close { to, code } => {
                    let now = self.clock.now();
                    if let Some(peer) = self.peers.remove(&to) {
                        peer.inbox.put_end(Ending::Closed(code));
                        self.front.handle_ended(now, to, Ending::Closed(code));
                    }
                }
            }
        }
    }

    /// Hands on control bytes that were held back and are wanted now; returns whether there were any.
    fn deliver(&mut self) -> bool {
        let mut any = false;
        let now = self.clock.now();
        for (from, peer) in &mut self.peers {
            while self.front.wants_control(*from)
                && let Some(bytes) = peer.held_back.pop_front()
            {
                self.front.handle_control(now, *from, &bytes);
                any = true;
            }
        }
        any
    }
}
