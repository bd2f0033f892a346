//! Shared state of the APP clients of a gateway, and why messages are refused.
//!
//! Options, the way to scenes, and which simulation belongs to which client. A client names its simulation on TCP and,
//! once, by a datagram, which may come first: simulation and address match the two. No state is sent to an address without
//! a logged-on connection.

use core::fmt;
use core::net::{IpAddr, SocketAddr};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard};

use rhumb_client::{OpenError, ServerConnection};
use rhumb_protocol::scene::{CommandError, Invalid};

use crate::message::Message;

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

/// Options of sending to APP clients. The defaults protect the published plug-in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AppOptions {
    /// Transport of the end of a frame.
    pub time_advanced: TimeAdvanced,
    /// Bodies whose state is sent in each frame.
    pub states: States,
    /// Messages per datagram.
    pub datagrams: Datagrams,
}

/// Transport of the end of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeAdvanced {
    /// TCP: the message is not lost when a burst of states overflows the client's buffer.
    #[default]
    Tcp,
    /// UDP: the last datagram of a frame, after its states.
    Udp,
    /// None: the published plug-in then keeps no list of received states, and shows a frame time of zero.
    Never,
}

/// Bodies whose state is sent in each frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum States {
    /// Every body that can move.
    All,
    /// Every body that is awake.
    Active,
    /// Every body that has moved since its last sent state; a body that comes to rest is sent again on TCP.
    #[default]
    Changed,
}

/// Messages per datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Datagrams {
    /// One, as the protocol has it: the published plug-in reads only the first.
    #[default]
    Single,
    /// As many as fit 1,472 bytes: to measure the effect of packing alone.
    Packed,
}

/// Reason of a refused message. The client is informed and continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// A number is not finite, or out of range.
    Number,
    /// A shape has invalid numbers.
    Shape(Invalid),
    /// The engine cannot make a solid of the shape.
    UnusableShape,
    /// Too many actors, shapes, joints, or parts of one actor.
    TooMany,
    /// Planes are not supported as shapes.
    Plane,
    /// No joint kind leaves these motions free.
    Joint,
    /// The joint's actor does not exist.
    JointTo(u32),
    /// The frame's time is zero, more than a second, or not expressible in ticks.
    Time,
    /// The scene refuses the command.
    Scene(CommandError),
}

/// A refused message and its actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RefusedMessage {
    /// Index of the message; if it fails only at the frame, of the last message about the actor.
    pub(super) index: u32,
    /// The actor, if the frame failed at one.
    pub(super) actor: Option<u32>,
    /// The reason.
    pub(super) refusal: Refusal,
}

impl RefusedMessage {
    /// A refusal when the message arrives.
    pub(super) const fn at_once(index: u32, refusal: Refusal) -> Self {
        Self {
            index,
            actor: None,
            refusal,
        }
    }

    /// A refusal of an actor's changes at a frame.
    pub(super) const fn at_frame(index: u32, actor: u32, refusal: Refusal) -> Self {
        Self {
            index,
            actor: Some(actor),
            refusal,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number => f.write_str("a number is not finite or out of range"),
            Self::Shape(invalid) => write!(f, "the shape is refused: {invalid}"),
            Self::UnusableShape => f.write_str("the engine cannot make a solid of the shape"),
            Self::TooMany => f.write_str("the limit of these is reached"),
            Self::Plane => f.write_str("planes are not supported as shapes"),
            Self::Joint => f.write_str("no joint kind leaves these motions free"),
            Self::JointTo(actor) => write!(f, "the joint's actor {actor} does not exist"),
            Self::Time => f.write_str("a frame must be longer than zero and at most a second"),
            Self::Scene(error) => write!(f, "the scene refuses it: {error}"),
        }
    }
}

impl From<Invalid> for Refusal {
    fn from(invalid: Invalid) -> Self {
        Self::Shape(invalid)
    }
}

impl From<CommandError> for Refusal {
    fn from(error: CommandError) -> Self {
        Self::Scene(error)
    }
}
