//! The state that the APP clients of one gateway share.
//!
//! Options, the way to scenes, and which simulation belongs to which client. A client names its simulation on TCP and,
//! once, by a datagram, which may come first: simulation and address match the two. No state is sent to an address without
//! a logged-on connection.

use core::fmt;
use core::net::{IpAddr, SocketAddr};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};

use rhumb_client::{OpenError, ServerConnection};

use crate::options::AppOptions;
use crate::wire::Message;

/// Reaches the server that has the scenes, once for each client.
type Connect = Box<dyn Fn() -> Result<ServerConnection, OpenError> + Send + Sync>;

/// A gateway of APP clients to a server, without sockets.
pub struct Gateway {
    pub(super) options: AppOptions,
    connect: Connect,
    simulations: Mutex<Simulations>,
}

#[derive(Debug, Default)]
struct Simulations {
    /// The simulations of logged-on clients.
    taken: BTreeMap<u32, StateAddress>,
    /// Datagram logons without a logged-on connection yet, oldest first.
    datagram_logons: VecDeque<(u32, SocketAddr)>,
}

/// The address for the states of a simulation.
#[derive(Clone, Copy, Debug)]
struct StateAddress {
    /// The address of its connection.
    client: IpAddr,
    /// TCP while it is unknown.
    states_to: Option<SocketAddr>,
}

/// Error: another connection has the simulation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Taken;

/// Datagram logons that are stored.
const DATAGRAM_LOGONS_MAX: usize = 256;

impl Gateway {
    /// A gateway without clients. Each client gets a connection of its own to the server, with the first frame that it
    /// asks for: `connect` makes it.
    #[must_use]
    pub fn new(
        options: AppOptions,
        connect: impl Fn() -> Result<ServerConnection, OpenError> + Send + Sync + 'static,
    ) -> Arc<Self> {
        Arc::new(Self {
            options,
            connect: Box::new(connect),
            simulations: Mutex::default(),
        })
    }

    /// A datagram from any address.
    pub fn handle_datagram(&self, from: SocketAddr, bytes: &[u8]) {
        // Logons are the only datagrams of clients; others are ignored.
        let Ok(Message::Logon(logon)) = Message::from_datagram(bytes) else {
            return;
        };
        let mut simulations = self.lock();
        // A client with a destination keeps it, whichever address names its simulation later.
        if let Some(taken) = simulations.taken.get_mut(&logon.simulation)
            && taken.client == from.ip()
            && taken.states_to.is_none()
        {
            taken.states_to = Some(from);
            return;
        }
        if simulations.datagram_logons.len() >= DATAGRAM_LOGONS_MAX {
            simulations.datagram_logons.pop_front();
        }
        simulations
            .datagram_logons
            .push_back((logon.simulation, from));
    }

    pub(super) fn connect(&self) -> Result<ServerConnection, OpenError> {
        (self.connect)()
    }

    /// Gives a simulation to a client, with the destination that its datagram has named, if that came first; the last one
    /// counts.
    pub(super) fn take(&self, simulation: u32, client: IpAddr) -> Result<(), Taken> {
        let mut simulations = self.lock();
        if simulations.taken.contains_key(&simulation) {
            return Err(Taken);
        }
        let logons = &mut simulations.datagram_logons;
        let is_its =
            |(named, from): &(u32, SocketAddr)| *named == simulation && from.ip() == client;
        let last = logons.iter().copied().rfind(is_its);
        logons.retain(|logon| !is_its(logon));
        let states_to = last.map(|(_, from)| from);
        let destination = StateAddress { client, states_to };
        simulations.taken.insert(simulation, destination);
        Ok(())
    }

    /// The address for the states of a client's simulation; `None`: by TCP.
    pub(super) fn states_to(&self, simulation: u32) -> Option<SocketAddr> {
        self.lock().taken.get(&simulation)?.states_to
    }

    /// Frees the simulation of a client.
    pub(super) fn free(&self, simulation: u32) {
        self.lock().taken.remove(&simulation);
    }

    fn lock(&self) -> MutexGuard<'_, Simulations> {
        self.simulations
            .lock()
            .expect("nothing panics while numbers are locked")
    }
}

impl fmt::Debug for Gateway {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Gateway")
            .field("options", &self.options)
            .field("simulations", &self.simulations)
            .finish_non_exhaustive()
    }
}
