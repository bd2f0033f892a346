//! Counters of a running server, read from outside its threads.
//!
//! Changes nothing. The sums keep a connection's counts after its end.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use quinn::Connection;
use rhumb_protocol::Peer;

use super::statistics::{ServerStatistics, WireStatistics};

/// Reads a server's counters while it runs and after; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct ServerWatch {
    shared: Arc<WatchState>,
}

#[derive(Debug, Default)]
struct WatchState {
    connections: Mutex<Connections>,
    counters: Counters,
}

#[derive(Debug, Default)]
struct Connections {
    standing: BTreeMap<Peer, Connection>,
    ended: WireStatistics,
}

/// The counters behind [`ServerStatistics`].
#[derive(Debug, Default)]
pub(super) struct Counters {
    pub(super) opened: AtomicU64,
    pub(super) ended: AtomicU64,
    pub(super) refused: AtomicU64,
    pub(super) control_overflows: AtomicU64,
    pub(super) state_dropped: AtomicU64,
    pub(super) state_oversized: AtomicU64,
}

impl ServerWatch {
    /// The present counters.
    #[must_use]
    pub fn statistics(&self) -> ServerStatistics {
        let read = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let counters = &self.shared.counters;
        ServerStatistics {
            opened: read(&counters.opened),
            ended: read(&counters.ended),
            refused: read(&counters.refused),
            control_overflows: read(&counters.control_overflows),
            state_dropped: read(&counters.state_dropped),
            state_oversized: read(&counters.state_oversized),
        }
    }

    /// The traffic of each open connection, by peer.
    #[must_use]
    pub fn connections(&self) -> Vec<(Peer, SocketAddr, WireStatistics)> {
        let connections = self.lock();
        let row = |(peer, connection): (&Peer, &Connection)| {
            (
                *peer,
                connection.remote_address(),
                WireStatistics::of(connection),
            )
        };
        connections.standing.iter().map(row).collect()
    }

    /// The traffic of all connections, open and ended.
    #[must_use]
    pub fn traffic(&self) -> WireStatistics {
        let connections = self.lock();
        let mut sum = connections.ended;
        for connection in connections.standing.values() {
            sum += WireStatistics::of(connection);
        }
        sum
    }

    pub(super) fn count(&self, pick: impl FnOnce(&Counters) -> &AtomicU64) {
        pick(&self.shared.counters).fetch_add(1, Ordering::Relaxed);
    }

    pub(super) fn opened(&self, peer: Peer, connection: Connection) {
        self.count(|counters| &counters.opened);
        self.lock().standing.insert(peer, connection);
    }

    pub(super) fn ended(&self, peer: Peer) {
        self.count(|counters| &counters.ended);
        let mut connections = self.lock();
        if let Some(connection) = connections.standing.remove(&peer) {
            connections.ended += WireStatistics::of(&connection);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Connections> {
        self.shared
            .connections
            .lock()
            .expect("reading counters never panics")
    }
}
