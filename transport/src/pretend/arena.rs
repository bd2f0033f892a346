//! A server and its clients, joined by pretended links, in virtual time.
//!
//! Has no thread and no clock. Does what `QuicServer::run` and its clients do, so that an endpoint cannot tell them apart;
//! what it leaves out is the handshake and the idle time-out (see `sever`). The same seed gives the same run, to the bit.

use std::collections::VecDeque;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};

use super::counts::LinkCounts;
use super::link::{Lane, Link};
use super::terms::LinkTerms;
use crate::gauge::Gauge;

/// Which way a link leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Direction {
    /// From a client to the server.
    Up,
    /// From the server to a client.
    Down,
}

/// Why a run came to rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rest {
    /// Nothing is under way and nobody wants to be woken.
    Idle,
    /// The moment that was asked for has come.
    Deadline,
}

/// One server, many clients, and what lies between them.
///
/// Client `n` is `Peer(n)` to the server; the server is `Peer(0)` to each client.
#[derive(Debug)]
pub struct Arena<S, C> {
    now: Instant,
    seed: u64,
    terms: LinkTerms,
    server: S,
    clients: Vec<Seat<C>>,
}

/// A client and its way to the server.
#[derive(Debug)]
struct Seat<C> {
    client: C,
    up: Way,
    down: Way,
    stands: Stands,
    gauge: Gauge,
}

/// One direction: a link, and what its control lane carries in order.
#[derive(Debug)]
struct Way {
    link: Link,
    control: VecDeque<Word>,
    talk: Talk,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Word {
    Bytes,
    Close(u32),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Talk {
    Open,
    /// The sender has closed: it says and hears nothing more.
    Closed,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stands {
    Yes,
    No,
}

/// What came out of a link.
enum Arrival {
    Control(Bytes),
    State(Bytes),
    Close(u32),
}

/// The server, as each client names it.
const SERVER: Peer = Peer(0);

/// Turns at one moment after which an endpoint must be asking for a wake-up that it never lets pass.
const TURNS_PER_MOMENT_MAX: u32 = 100_000;

impl<S: Endpoint, C: Endpoint> Arena<S, C> {
    /// An arena without clients, at time zero; its links will have these terms.
    #[must_use]
    pub fn new(server: S, terms: LinkTerms, seed: u64) -> Self {
        Self {
            now: Instant::ZERO,
            seed,
            terms,
            server,
            clients: Vec::new(),
        }
    }

    /// Joins a client to the server, at once for both, and returns its index.
    pub fn connect(&mut self, client: C) -> usize {
        let index = self.clients.len();
        let way = |direction| Way {
            link: Link::new(self.terms, way_seed(self.seed, index, direction)),
            control: VecDeque::new(),
            talk: Talk::Open,
        };
        let (up, down) = (way(Direction::Up), way(Direction::Down));
        self.clients.push(Seat {
            client,
            up,
            down,
            stands: Stands::Yes,
            gauge: Gauge::new(self.now),
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
        if self.clients[index].stands == Stands::Yes {
            self.end(index, ending);
            self.drain();
        }
    }

    /// Changes the terms of every link, and of those to come.
    pub fn set_terms(&mut self, terms: LinkTerms) {
        self.terms = terms;
        for seat in &mut self.clients {
            seat.up.link.set_terms(terms);
            seat.down.link.set_terms(terms);
        }
    }

    /// Changes the terms of one client's link in one direction.
    ///
    /// # Panics
    ///
    /// If no client has this index.
    pub fn set_terms_of(&mut self, index: usize, direction: Direction, terms: LinkTerms) {
        self.clients[index].way_mut(direction).link.set_terms(terms);
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
    pub fn run_until_idle_or(&mut self, deadline: Instant) -> Rest {
        self.run(deadline);
        if self.next_at().is_none() {
            return Rest::Idle;
        }
        self.now = self.now.max(deadline);
        Rest::Deadline
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
        self.clients[index].way(direction).link.counts(lane)
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
            self.land();
            self.wake();
            self.report();
            self.drain();
        }
    }

    /// The earliest moment at which anything happens.
    fn next_at(&self) -> Option<Instant> {
        let wake = |endpoint: Option<rhumb_protocol::Wake>| endpoint.map(|wake| wake.at);
        let seats = self.clients.iter().flat_map(|seat| {
            let links = [&seat.up, &seat.down]
                .into_iter()
                .filter_map(|way| way.link.next_at());
            links
                .filter(|_| seat.stands == Stands::Yes)
                .chain(wake(seat.client.poll_timeout()))
        });
        seats.chain(wake(self.server.poll_timeout())).min()
    }

    /// Hands over all that has arrived, client by client.
    fn land(&mut self) {
        for index in 0..self.clients.len() {
            while let Some(arrival) = self.arrival(index, Direction::Up) {
                self.land_up(index, arrival);
            }
            while let Some(arrival) = self.arrival(index, Direction::Down) {
                self.land_down(index, arrival);
            }
        }
    }

    fn arrival(&mut self, index: usize, direction: Direction) -> Option<Arrival> {
        let seat = &mut self.clients[index];
        if seat.stands == Stands::No {
            return None;
        }
        seat.way_mut(direction).pop(self.now)
    }

    fn land_up(&mut self, index: usize, arrival: Arrival) {
        let deaf = self.clients[index].down.talk == Talk::Closed;
        match arrival {
            Arrival::Close(code) => self.end(index, Ending::Closed(code)),
            _ if deaf => {}
            Arrival::Control(bytes) => self.server.handle_control(self.now, peer(index), &bytes),
            Arrival::State(bytes) => self.server.handle_datagram(self.now, peer(index), &bytes),
        }
    }

    fn land_down(&mut self, index: usize, arrival: Arrival) {
        let now = self.now;
        let seat = &mut self.clients[index];
        let deaf = seat.up.talk == Talk::Closed;
        match arrival {
            Arrival::Close(code) => self.end(index, Ending::Closed(code)),
            _ if deaf => {}
            Arrival::Control(bytes) => seat.client.handle_control(now, SERVER, &bytes),
            Arrival::State(bytes) => seat.client.handle_datagram(now, SERVER, &bytes),
        }
    }

    fn end(&mut self, index: usize, ending: Ending) {
        let seat = &mut self.clients[index];
        seat.stands = Stands::No;
        seat.client.handle_ended(self.now, SERVER, ending);
        self.server.handle_ended(self.now, peer(index), ending);
    }

    /// Wakes whoever is due.
    fn wake(&mut self) {
        let now = self.now;
        if is_due(&self.server, now) {
            self.server.handle_timeout(now);
        }
        for seat in &mut self.clients {
            if is_due(&seat.client, now) {
                seat.client.handle_timeout(now);
            }
        }
    }

    /// Tells the server how the links to its clients do.
    fn report(&mut self) {
        let now = self.now;
        for (index, seat) in self.clients.iter_mut().enumerate() {
            if seat.stands == Stands::No || !seat.gauge.is_due(now) {
                continue;
            }
            let link = &seat.down.link;
            let pushed = |lane| link.counts(lane).pushed.bytes;
            let handed = pushed(Lane::State) + pushed(Lane::Control);
            let delay = |way: &Way| way.link.terms().delay.as_nanos();
            let round_trip = Span::from_nanos(delay(&seat.up) + delay(&seat.down));
            let waiting = link.waiting_bytes(now);
            let report = seat.gauge.read(now, handed, waiting, round_trip);
            self.server.handle_link(now, peer(index), &report);
        }
    }

    /// Puts all that the endpoints say onto the links.
    fn drain(&mut self) {
        while let Some(transmit) = self.server.poll_transmit() {
            let index = usize::try_from(addressee(&transmit).0).ok();
            if let Some(seat) = index.and_then(|index| self.clients.get_mut(index)) {
                seat.send(Direction::Down, self.now, transmit);
            }
        }
        for seat in &mut self.clients {
            while let Some(transmit) = seat.client.poll_transmit() {
                seat.send(Direction::Up, self.now, transmit);
            }
        }
    }
}

impl<C> Seat<C> {
    fn send(&mut self, direction: Direction, now: Instant, transmit: Transmit) {
        if self.stands == Stands::Yes {
            self.way_mut(direction).push(now, transmit);
        }
    }

    fn way(&self, direction: Direction) -> &Way {
        match direction {
            Direction::Up => &self.up,
            Direction::Down => &self.down,
        }
    }

    fn way_mut(&mut self, direction: Direction) -> &mut Way {
        match direction {
            Direction::Up => &mut self.up,
            Direction::Down => &mut self.down,
        }
    }
}

impl Way {
    fn push(&mut self, now: Instant, transmit: Transmit) {
        if self.talk == Talk::Closed {
            return;
        }
        match transmit {
            Transmit::State { bytes, .. } => self.link.push(now, bytes, Lane::State),
            Transmit::Control { bytes, .. } => {
                self.control.push_back(Word::Bytes);
                self.link.push(now, bytes, Lane::Control);
            }
            Transmit::Close { code, .. } => {
                self.talk = Talk::Closed;
                self.control.push_back(Word::Close(code));
                self.link.push(now, Bytes::new(), Lane::Control);
            }
        }
    }

    fn pop(&mut self, now: Instant) -> Option<Arrival> {
        let (lane, bytes) = self.link.pop(now)?;
        if lane == Lane::State {
            return Some(Arrival::State(bytes));
        }
        match self
            .control
            .pop_front()
            .expect("a word for each piece of control")
        {
            Word::Bytes => Some(Arrival::Control(bytes)),
            Word::Close(code) => Some(Arrival::Close(code)),
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
fn way_seed(seed: u64, index: usize, direction: Direction) -> u64 {
    let link = 2 * index as u64 + direction as u64;
    seed ^ link.wrapping_add(1).wrapping_mul(GOLDEN_RATIO)
}

/// 2⁶⁴ over the golden ratio: neighbouring links get distant seeds. Source: Knuth, TAOCP 3, section 6.4.
const GOLDEN_RATIO: u64 = 0x9e37_79b9_7f4a_7c15;
