//! A running server as other threads see it: its counters, and its stop.
//!
//! Reading changes nothing. The sums keep a connection's counts after its end. A stop may be requested from any
//! thread, but not inside a signal handler, since it locks. A request cannot be withdrawn.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

use quinn::Connection;
use rhumb_link::WireStatistics;
use rhumb_link::connection::wire_statistics;
use rhumb_protocol::Peer;

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

/// Counters of a server over its whole life.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServerStatistics {
    /// Connections that were opened.
    pub opened: u64,
    /// Connections that have ended.
    pub ended: u64,
    /// Attempts refused because the server was full.
    pub refused: u64,
    /// Connections closed because their peer read control bytes too slowly.
    pub control_overflows: u64,
    /// Datagrams from clients dropped because the server thread was late.
    pub state_dropped: u64,
    /// Datagrams to clients that were larger than the path allows.
    pub state_oversized: u64,
}

/// The counters behind [`ServerStatistics`].
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) opened: AtomicU64,
    pub(crate) ended: AtomicU64,
    pub(crate) refused: AtomicU64,
    pub(crate) control_overflows: AtomicU64,
    pub(crate) state_dropped: AtomicU64,
    pub(crate) state_oversized: AtomicU64,
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
                wire_statistics(connection),
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
            sum += wire_statistics(connection);
        }
        sum
    }

    pub(crate) fn count(&self, pick: impl FnOnce(&Counters) -> &AtomicU64) {
        pick(&self.shared.counters).fetch_add(1, Ordering::Relaxed);
    }

    pub(crate) fn opened(&self, peer: Peer, connection: Connection) {
        self.count(|counters| &counters.opened);
        self.lock().standing.insert(peer, connection);
    }

    pub(crate) fn ended(&self, peer: Peer) {
        self.count(|counters| &counters.ended);
        let mut connections = self.lock();
        if let Some(connection) = connections.standing.remove(&peer) {
            connections.ended += wire_statistics(&connection);
        }
    }

    fn lock(&self) -> MutexGuard<'_, Connections> {
        self.shared
            .connections
            .lock()
            .expect("reading counters never panics")
    }
}

/// Requests a running server to stop; all clones are one request.
#[derive(Clone, Default)]
pub struct Stop {
    shared: Arc<Mutex<StopState>>,
}

#[derive(Default)]
struct StopState {
    requested: bool,
    wakes: Vec<Box<dyn Fn() + Send>>,
}

impl Stop {
    /// No request yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Requests the stop. Servers that run with it close their connections and return; later ones return at once.
    pub fn stop(&self) {
        let mut shared = self.lock();
        shared.requested = true;
        for wake in shared.wakes.drain(..) {
            wake();
        }
    }

    /// True if the stop was requested.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.lock().requested
    }

    /// Calls `wake` once at the request, or now if it was made already.
    pub(crate) fn on_stop(&self, wake: impl Fn() + Send + 'static) {
        let mut shared = self.lock();
        if shared.requested {
            wake();
        } else {
            shared.wakes.push(Box::new(wake));
        }
    }

    fn lock(&self) -> MutexGuard<'_, StopState> {
        self.shared.lock().expect("a wake-up never panics")
    }
}

impl fmt::Debug for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Stop")
            .field("requested", &self.is_requested())
            .finish()
    }
}
