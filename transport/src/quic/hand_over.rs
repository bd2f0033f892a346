//! Datagrams from the host thread to the sockets: all of a drain at once.
//!
//! To wake the I/O thread is a call of the system, so that it is woken once and not for each datagram. Bounded: what finds
//! no room is handed to its connection by the host thread itself.

use std::sync::Arc;

use bytes::Bytes;
use quinn::{Connection, SendDatagramError};
use rhumb_protocol::Peer;
use tokio::sync::mpsc;
use tokio::sync::mpsc::error::TrySendError;

use super::watch::ServerWatch;

/// A datagram and who is to have it.
#[derive(Debug)]
pub(super) struct State {
    pub(super) peer: Peer,
    /// Shared: a copy of one takes its lock.
    pub(super) connection: Arc<Connection>,
    pub(super) bytes: Bytes,
}

/// The host thread's end.
#[derive(Debug)]
pub(super) struct Giver {
    drains: mpsc::Sender<Vec<State>>,
    watch: ServerWatch,
}

/// The I/O thread's end.
#[derive(Debug)]
pub(super) struct Taker {
    drains: mpsc::Receiver<Vec<State>>,
    watch: ServerWatch,
}

/// Drains that wait for the I/O thread: one stays for as long as that has other things to do.
const DRAINS_MAX: usize = 16;

/// Both ends.
pub(super) fn hand_over(watch: &ServerWatch) -> (Giver, Taker) {
    let (giver, taker) = mpsc::channel(DRAINS_MAX);
    let giver = Giver {
        drains: giver,
        watch: watch.clone(),
    };
    let taker = Taker {
        drains: taker,
        watch: watch.clone(),
    };
    (giver, taker)
}

impl Giver {
    /// Hands over the datagrams of a drain.
    pub(super) fn give(&self, states: Vec<State>) {
        // One wakes its connection as cheaply as the one that takes them.
        if states.len() < 2 {
            return self.give_now(states);
        }
        if let Err(TrySendError::Full(states) | TrySendError::Closed(states)) =
            self.drains.try_send(states)
        {
            self.give_now(states);
        }
    }

    /// Gives them to their connections at once.
    pub(super) fn give_now(&self, states: Vec<State>) {
        for state in states {
            state.send(&self.watch);
        }
    }
}

impl Taker {
    /// Gives to the connections what is handed over, until nobody does any more.
    pub(super) async fn run(mut self) {
        while let Some(states) = self.drains.recv().await {
            for state in states {
                state.send(&self.watch);
            }
        }
    }
}

impl State {
    fn send(self, watch: &ServerWatch) {
        let bytes_len = self.bytes.len();
        match self.connection.send_datagram(self.bytes) {
            Ok(()) | Err(SendDatagramError::ConnectionLost(_)) => {}
            Err(cause) => {
                watch.count(|counters| &counters.state_oversized);
                tracing::warn!(peer = self.peer.0, bytes_len, %cause, "state datagram not sent");
            }
        }
    }
}
