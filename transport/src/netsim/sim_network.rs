//! A server and its clients, joined by simulated links, in virtual time.
//!
//! Has no thread and no clock. Does what `QuicServer::run` and its clients do, so that an endpoint cannot tell them apart;
//! what it leaves out is the handshake and the idle time-out (see `sever`). The same seed gives the same run, to the bit.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};

use super::config::LinkConfig;
use super::counts::LinkCounts;
use super::link::{Lane, Link};
use crate::link_meter::LinkMeter;

/// Which sim_direction a link leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From a client to the server.
    Up,
    /// From the server to a client.
    Down,
}

/// Why a run came to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunStop {
    /// Nothing is under sim_direction and nobody wants to be woken.
    Idle,
    /// The moment that was asked for has come.
    Deadline,
}

/// One server, many clients, and what lies between them.
///
/// Client `n` is `Peer(n)` to the server; the server is `Peer(0)` to each client.
#[derive(Debug)]
pub struct SimNetwork<S, C> {
    now: Instant,
    seed: u64,
    config: LinkConfig,
    server: S,
    clients: Vec<SimClient<C>>,
}

/// A client and its sim_direction to the server.
#[derive(Debug)]
struct SimClient<C> {
    client: C,
    up: SimDirection,
    down: SimDirection,
    connected: Connected,
    link_meter: LinkMeter,
}

/// One direction: a link, and what its control lane carries in order.
#[derive(Debug)]
struct SimDirection {
    link: Link,
    control: VecDeque<SimControl>,
    sender_state: SenderState,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SimControl {
    Bytes,
    Close(u32),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SenderState {
    Open,
    /// The sender has closed: it says and hears nothing more.
    Closed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Connected {
    Yes,
    No,
}

/// What came out of a link.
enum Delivered {
    Control(Bytes),
    State(Bytes),
    Close(u32),
}

/// The server, as each client names it.
const SERVER: Peer = Peer(0);

/// Turns at one moment after which an endpoint must be asking for a wake-up that it never lets pass.
const TURNS_PER_MOMENT_MAX: u32 = 100_000;

impl<S: Endpoint, C: Endpoint> SimNetwork<S, C> {
    /// An network without clients, at time zero; its links will have these config.
    #[must_use]
    pub fn new(server: S, config: LinkConfig, seed: u64) -> Self {
        Self {
            now: Instant::ZERO,
            seed,
            config,
            server,
            clients: Vec::new(),
        }
    }

    /// Joins a client to the server, at once for both, and returns its index.
    pub fn connect(&mut self, client: C) -> usize {
        let index = self.clients.len();
        let sim_direction = |direction| SimDirection {
            link: Link::new(self.config, direction_seed(self.seed, index, direction)),
            control: VecDeque::new(),
            sender_state: SenderState::Open,
        };
        let (up, down) = (sim_direction(Direction::Up), sim_direction(Direction::Down));
        self.clients.push(SimClient {
            client,
            up,
            down,
            connected: Connected::Yes,
            link_meter: LinkMeter::new(self.now),
        });
        self.server.handle_opened(self.now, peer(index));
        self.clients[index].client.handle_opened(self.now, SERVER);
        self.drain();
        index
    }

    /// Ends a connection for both ends at once, as a time-out or a fault would; nothing if it had ended.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn sever(&mut self, index: usize, ending: Ending) {
        if self.clients[index].connected == Connected::Yes {
            self.end(index, ending);
            self.drain();
        }
    }

    /// Changes the config of every link, and of those to come.
    pub fn set_config(&mut self, config: LinkConfig) {
        self.config = config;
        for alias in &mut self.clients {
            alias.up.link.set_config(config);
            alias.down.link.set_config(config);
        }
    }

    /// Changes the config of one client's link in one direction.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn set_config_of(&mut self, index: usize, direction: Direction, config: LinkConfig) {
        self.clients[index]
            .sim_direction_mut(direction)
            .link
            .set_config(config);
    }

    /// Lets time pass to this moment, everything that is due by then included.
    ///
    /// # Panics
    ///
    /// If an endpoint asks again and again for a wake-up that has passed.
    pub fn run_until(&mut self, deadline: Instant) {
        self.run(deadline);
        self.now = self.now.max(deadline);
    }

    /// Lets time pass until nothing is left to happen, or to this moment.
    ///
    /// An endpoint that always wants another wake-up, as a free-running server does, never rests before the deadline.
    ///
    /// # Panics
    ///
    /// As [`run_until`](Self::run_until).
    pub fn run_until_idle_or(&mut self, deadline: Instant) -> RunStop {
        self.run(deadline);
        if self.next_at().is_none() {
            return RunStop::Idle;
        }
        self.now = self.now.max(deadline);
        RunStop::Deadline
    }

    /// The server, to give it commands; what it says leaves when time passes.
    pub fn server_mut(&mut self) -> &mut S {
        &mut self.server
    }

    /// A client, to give it commands; what it says leaves when time passes.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn client_mut(&mut self, index: usize) -> &mut C {
        &mut self.clients[index].client
    }

    /// The moment it is.
    #[must_use]
    pub fn now(&self) -> Instant {
        self.now
    }

    /// The server.
    #[must_use]
    pub fn server(&self) -> &S {
        &self.server
    }

    /// A client.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    #[must_use]
    pub fn client(&self, index: usize) -> &C {
        &self.clients[index].client
    }

    /// How many clients ever connected.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// What happened on a client's link.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    #[must_use]
    pub fn counts(&self, index: usize, direction: Direction, lane: Lane) -> LinkCounts {
        self.clients[index]
            .sim_direction(direction)
            .link
            .counts(lane)
    }

    fn run(&mut self, deadline: Instant) {
        self.drain();
        let mut turns = 0;
        while let Some(at) = self.next_at().filter(|&at| at <= deadline) {
            turns = if at > self.now { 0 } else { turns + 1 };
            assert!(
                turns < TURNS_PER_MOMENT_MAX,
                "an endpoint wants a wake-up that it never lets pass"
            );
            self.now = self.now.max(at);
            self.deliver();
            self.wake();
            self.report();
            self.drain();
        }
    }

    /// The earliest moment at which anything happens.
    fn next_at(&self) -> Option<Instant> {
        let wake = |endpoint: Option<rhumb_protocol::Wake>| endpoint.map(|wake| wake.at);
        let aliases = self.clients.iter().flat_map(|alias| {
            let links = [&alias.up, &alias.down]
                .into_iter()
                .filter_map(|sim_direction| sim_direction.link.next_at());
            links
                .filter(|_| alias.connected == Connected::Yes)
                .chain(wake(alias.client.poll_timeout()))
        });
        aliases.chain(wake(self.server.poll_timeout())).min()
    }

    /// Hands over all that has arrived, client by client.
    fn deliver(&mut self) {
        for index in 0..self.clients.len() {
            while let Some(arrival) = self.arrival(index, Direction::Up) {
                self.deliver_up(index, arrival);
            }
            while let Some(arrival) = self.arrival(index, Direction::Down) {
                self.deliver_down(index, arrival);
            }
        }
    }

    fn arrival(&mut self, index: usize, direction: Direction) -> Option<Delivered> {
        let alias = &mut self.clients[index];
        if alias.connected == Connected::No {
            return None;
        }
        alias.sim_direction_mut(direction).pop(self.now)
    }

    fn deliver_up(&mut self, index: usize, arrival: Delivered) {
        let deaf = self.clients[index].down.sender_state == SenderState::Closed;
        match arrival {
            Delivered::Close(code) => self.end(index, Ending::Closed(code)),
            _ if deaf => {}
            Delivered::Control(bytes) => self.server.handle_control(self.now, peer(index), &bytes),
            Delivered::State(bytes) => self.server.handle_datagram(self.now, peer(index), &bytes),
        }
    }

    fn deliver_down(&mut self, index: usize, arrival: Delivered) {
        let now = self.now;
        let alias = &mut self.clients[index];
        let deaf = alias.up.sender_state == SenderState::Closed;
        match arrival {
            Delivered::Close(code) => self.end(index, Ending::Closed(code)),
            _ if deaf => {}
            Delivered::Control(bytes) => alias.client.handle_control(now, SERVER, &bytes),
            Delivered::State(bytes) => alias.client.handle_datagram(now, SERVER, &bytes),
        }
    }

    fn end(&mut self, index: usize, ending: Ending) {
        let alias = &mut self.clients[index];
        alias.connected = Connected::No;
        alias.client.handle_ended(self.now, SERVER, ending);
        self.server.handle_ended(self.now, peer(index), ending);
    }

    /// Wakes whoever is due.
    fn wake(&mut self) {
        let now = self.now;
        if is_due(&self.server, now) {
            self.server.handle_timeout(now);
        }
        for alias in &mut self.clients {
            if is_due(&alias.client, now) {
                alias.client.handle_timeout(now);
            }
        }
    }

    /// Tells the server how the links to its clients do.
    fn report(&mut self) {
        let now = self.now;
        for (index, alias) in self.clients.iter_mut().enumerate() {
            if alias.connected == Connected::No || !alias.link_meter.is_due(now) {
                continue;
            }
            let link = &alias.down.link;
            let pushed = |lane| link.counts(lane).pushed.bytes;
            let handed = pushed(Lane::State) + pushed(Lane::Control);
            let delay = |sim_direction: &SimDirection| sim_direction.link.config().delay.as_nanos();
            let round_trip = Span::from_nanos(delay(&alias.up) + delay(&alias.down));
            let waiting = link.waiting_bytes(now);
            let report = alias.link_meter.read(now, handed, waiting, round_trip);
            self.server.handle_link(now, peer(index), &report);
        }
    }

    /// Puts all that the endpoints say onto the links.
    fn drain(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            let index = usize::try_from(addressee(&transmit).0).ok();
            if let Some(alias) = index.and_then(|index| self.clients.get_mut(index)) {
                alias.send(Direction::Down, self.now, transmit);
            }
        }
        for alias in &mut self.clients {
            while let Some(transmit) = alias.client.poll_transmit() {
                alias.send(Direction::Up, self.now, transmit);
            }
        }
    }
}

impl<C> SimClient<C> {
    fn send(&mut self, direction: Direction, now: Instant, transmit: Transmit) {
        if self.connected == Connected::Yes {
            self.sim_direction_mut(direction).push(now, transmit);
        }
    }

    fn sim_direction(&self, direction: Direction) -> &SimDirection {
        match direction {
            Direction::Up => &self.up,
            Direction::Down => &self.down,
        }
    }

    fn sim_direction_mut(&mut self, direction: Direction) -> &mut SimDirection {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }
}

impl SimDirection {
    fn push(&mut self, now: Instant, transmit: Transmit) {
        if self.sender_state == SenderState::Closed {
            return;
        }
        match transmit {
            Transmit::State { bytes, .. } => self.link.push(now, bytes, Lane::State),
            Transmit::Control { bytes, .. } => {
                self.control.push_back(SimControl::Bytes);
                self.link.push(now, bytes, Lane::Control);
            }
            Transmit::Close { code, .. } => {
                self.sender_state = SenderState::Closed;
                self.control.push_back(SimControl::Close(code));
                self.link.push(now, Bytes::new(), Lane::Control);
            }
        }
    }

    fn pop(&mut self, now: Instant) -> Option<Delivered> {
        let (lane, bytes) = self.link.pop(now)?;
        if lane == Lane::State {
            return Some(Delivered::State(bytes));
        }
        match self
            .control
            .pop_front()
            .expect("a word for each piece of control")
        {
            SimControl::Bytes => Some(Delivered::Control(bytes)),
            SimControl::Close(code) => Some(Delivered::Close(code)),
        }
    }
}

fn is_due<E: Endpoint>(endpoint: &E, now: Instant) -> bool {
    endpoint.poll_timeout().is_some_and(|wake| wake.at <= now)
}

fn addressee(transmit: &Transmit) -> Peer {
    match transmit {
        Transmit::Control { to, .. } | Transmit::State { to, .. } | Transmit::Close { to, .. } => {
            *to
        }
    }
}

fn peer(index: usize) -> Peer {
    Peer(index as u64)
}

/// Every link has chance of its own, and none changes when another client joins.
fn direction_seed(seed: u64, index: usize, direction: Direction) -> u64 {
    let link = 2 * index as u64 + direction as u64;
    seed ^ link.wrapping_add(1).wrapping_mul(GOLDEN_RATIO)
}

/// 2⁶⁴ over the golden ratio: neighbouring links get distant seeds. Source: Knuth, TAOCP 3, section 6.4.
const GOLDEN_RATIO: u64 = 0x9e37_79b9_7f4a_7c15;
