//! A server and its clients, joined by simulated links, in virtual time.
//!
//! No thread and no clock. To an endpoint, it behaves as `QuicServer::run` and its clients do, without the handshake
//! and the idle timeout (see `sever`). Equal seeds give equal runs, to the bit.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};

use rhumb_transport::LinkMeter;
use rhumb_transport::conditioner::{Direction, Lane, Link, LinkConfig, LinkCounts};

/// Reason why a run returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RunStop {
    /// Nothing is in transit and no endpoint has a timeout.
    Idle,
    /// The deadline is reached.
    Deadline,
}

/// One server, its clients, and the links between them.
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

/// A client and its links.
#[derive(Debug)]
struct SimClient<C> {
    client: C,
    up: SimDirection,
    down: SimDirection,
    connected: SimConnection,
    link_meter: LinkMeter,
}

/// One direction: a link, and the order of its control lane.
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
    /// The sender has closed: it sends and receives nothing more.
    Closed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SimConnection {
    Open,
    Ended,
}

/// One delivery of a link.
enum Delivered {
    Control(Bytes),
    State(Bytes),
    Close(u32),
}

/// The server's peer number at each client.
const SERVER: Peer = Peer(0);

/// Limit of turns at one moment. Beyond it, an endpoint repeatedly sets a timeout in the past.
const TURNS_PER_MOMENT_MAX: u32 = 100_000;

impl<S: Endpoint, C: Endpoint> SimNetwork<S, C> {
    /// A network without clients, at time zero; its links get this configuration.
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

    /// Connects a client to the server, at once for both, and returns its index.
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
            connected: SimConnection::Open,
            link_meter: LinkMeter::new(self.now),
        });
        self.server.handle_opened(self.now, peer(index));
        self.clients[index].client.handle_opened(self.now, SERVER);
        self.drain();
        index
    }

    /// Ends a connection for both ends at once, as a timeout or a fault would; no-op if it has ended.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn sever(&mut self, index: usize, ending: Ending) {
        if self.clients[index].connected == SimConnection::Open {
            self.end(index, ending);
            self.drain();
        }
    }

    /// Changes the configuration of every present and later link.
    pub fn set_config(&mut self, config: LinkConfig) {
        self.config = config;
        for sim_client in &mut self.clients {
            sim_client.up.link.set_config(config);
            sim_client.down.link.set_config(config);
        }
    }

    /// Changes the configuration of one client's link in one direction.
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

    /// Advances time to this moment, and runs everything that is due by then.
    ///
    /// # Panics
    ///
    /// If an endpoint repeatedly sets a timeout in the past.
    pub fn run_until(&mut self, deadline: Instant) {
        self.run(deadline);
        self.now = self.now.max(deadline);
    }

    /// Advances time until the network is idle, or to this moment.
    ///
    /// An endpoint that always sets another timeout, as a free-running server does, is not idle before the deadline.
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

    /// The server, for commands; its transmissions leave when time advances.
    pub fn server_mut(&mut self) -> &mut S {
        &mut self.server
    }

    /// A client, for commands; its transmissions leave when time advances.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn client_mut(&mut self, index: usize) -> &mut C {
        &mut self.clients[index].client
    }

    /// The present moment.
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

    /// Number of clients that have connected, ended connections included.
    #[must_use]
    pub fn clients(&self) -> usize {
        self.clients.len()
    }

    /// The counters of a client's link.
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
                "an endpoint repeatedly sets a timeout in the past"
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
        let moments = self.clients.iter().flat_map(|sim_client| {
            let links = [&sim_client.up, &sim_client.down]
                .into_iter()
                .filter_map(|sim_direction| sim_direction.link.next_at());
            links
                .filter(|_| sim_client.connected == SimConnection::Open)
                .chain(wake(sim_client.client.poll_timeout()))
        });
        moments.chain(wake(self.server.poll_timeout())).min()
    }

    /// Delivers everything that has arrived, client by client.
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
        let sim_client = &mut self.clients[index];
        if sim_client.connected == SimConnection::Ended {
            return None;
        }
        sim_client.sim_direction_mut(direction).pop(self.now)
    }

    fn deliver_up(&mut self, index: usize, arrival: Delivered) {
        let has_closed = self.clients[index].down.sender_state == SenderState::Closed;
        match arrival {
            Delivered::Close(code) => self.end(index, Ending::Closed(code)),
            _ if has_closed => {}
            Delivered::Control(bytes) => self.server.handle_control(self.now, peer(index), &bytes),
            Delivered::State(bytes) => self.server.handle_datagram(self.now, peer(index), &bytes),
        }
    }

    fn deliver_down(&mut self, index: usize, arrival: Delivered) {
        let now = self.now;
        let sim_client = &mut self.clients[index];
        let has_closed = sim_client.up.sender_state == SenderState::Closed;
        match arrival {
            Delivered::Close(code) => self.end(index, Ending::Closed(code)),
            _ if has_closed => {}
            Delivered::Control(bytes) => sim_client.client.handle_control(now, SERVER, &bytes),
            Delivered::State(bytes) => sim_client.client.handle_datagram(now, SERVER, &bytes),
        }
    }

    fn end(&mut self, index: usize, ending: Ending) {
        let sim_client = &mut self.clients[index];
        sim_client.connected = SimConnection::Ended;
        sim_client.client.handle_ended(self.now, SERVER, ending);
        self.server.handle_ended(self.now, peer(index), ending);
    }

    /// Calls the endpoints whose timeout is due.
    fn wake(&mut self) {
        let now = self.now;
        if is_due(&self.server, now) {
            self.server.handle_timeout(now);
        }
        for sim_client in &mut self.clients {
            if is_due(&sim_client.client, now) {
                sim_client.client.handle_timeout(now);
            }
        }
    }

    /// Reports the links of its clients to the server.
    fn report(&mut self) {
        let now = self.now;
        for (index, sim_client) in self.clients.iter_mut().enumerate() {
            if sim_client.connected == SimConnection::Ended || !sim_client.link_meter.is_due(now) {
                continue;
            }
            let link = &sim_client.down.link;
            let pushed = |lane| link.counts(lane).pushed.bytes;
            let handed = pushed(Lane::State) + pushed(Lane::Control);
            let delay = |sim_direction: &SimDirection| sim_direction.link.config().delay.as_nanos();
            let round_trip = Span::from_nanos(delay(&sim_client.up) + delay(&sim_client.down));
            let waiting = link.waiting_bytes(now);
            let report = sim_client.link_meter.read(now, handed, waiting, round_trip);
            self.server.handle_link(now, peer(index), &report);
        }
    }

    /// Pushes the endpoints' transmissions into the links.
    fn drain(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            let index = usize::try_from(addressee(&transmit).0).ok();
            if let Some(sim_client) = index.and_then(|index| self.clients.get_mut(index)) {
                sim_client.send(Direction::Down, self.now, transmit);
            }
        }
        for sim_client in &mut self.clients {
            while let Some(transmit) = sim_client.client.poll_transmit() {
                sim_client.send(Direction::Up, self.now, transmit);
            }
        }
    }
}

impl<C> SimClient<C> {
    fn send(&mut self, direction: Direction, now: Instant, transmit: Transmit) {
        if self.connected == SimConnection::Open {
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
            .expect("each piece of the control lane has an entry")
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

/// Every link has its own random numbers, which do not change when another client connects.
fn direction_seed(seed: u64, index: usize, direction: Direction) -> u64 {
    let link = 2 * index as u64 + direction as u64;
    seed ^ link.wrapping_add(1).wrapping_mul(GOLDEN_RATIO)
}

/// 2⁶⁴ over the golden ratio: neighbouring links get distant seeds. Source: Knuth, TAOCP 3, section 6.4.
const GOLDEN_RATIO: u64 = 0x9e37_79b9_7f4a_7c15;
