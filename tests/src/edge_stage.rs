//! A scene, edges, and members of both, over simulated links in virtual time.
//!
//! The commander sends the commands of a script, directly or through an edge; the claims of all members are stored every few
//! milliseconds. No checks are made here. Runs with the same seed are bit-identical.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::rc::Rc;
use std::sync::Arc;

use rhumb_conformance::seed::Dice;
use rhumb_edge::{Edge, EdgeSettings, SharedPacket};
use rhumb_netsim::{Direction, Lane, LinkConfig, SimNetwork};
use rhumb_protocol::message::{SessionKey, StreamChoice};
use rhumb_protocol::scene::{Command, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake};
use rhumb_reckoning::Tick;
use rhumb_scene::{Limits, Permit, SceneRouter, SceneSettings};
use rhumb_sims::Script;

use crate::observation_history::ObservationHistory;
use crate::truth::{MemberRecord, SceneTruth};

/// Time between two looks at what edges want to connect, and at claims.
const INTERVAL: Span = Span::from_millis(1);
/// Longest virtual time for an answer over the worst link.
const ANSWER_TIME_LIMIT: Span = Span::from_millis(120_000);
const SCENE: &str = "stage";

/// Where a member is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// At the server of the scene.
    Owner,
    /// At the edge of this number.
    Edge(usize),
}

/// A scene with edges.
pub struct EdgeStage {
    owner: SimNetwork<SceneRouter, StagePeer>,
    edges: Vec<EdgeNode>,
    members: Vec<(Place, usize)>,
    /// The history of each member.
    pub histories: Vec<ObservationHistory>,
    config: SceneConfig,
    script: Box<dyn Script>,
    scripted: Tick,
    commands: Vec<Command>,
    seed: u64,
    now: Instant,
    dice: Dice,
    /// Packets of the fan-out that come later than others, with the edge to which they go.
    delayed: Vec<(usize, SharedPacket)>,
    /// Share of packets that the fan-out drops, percent.
    pub fan_out_loss: usize,
}

struct EdgeNode {
    shared: Rc<RefCell<EdgeState>>,
    network: SimNetwork<Face, StagePeer>,
    /// Its connections in the owner's network, or the hub's.
    links: Vec<usize>,
    /// The edge that is its owner, and publishes to it by the fan-out.
    hub: Option<usize>,
}

struct EdgeState {
    edge: Edge,
    to_owner: BTreeMap<Peer, VecDeque<Transmit>>,
    is_alive: bool,
    /// True if its members are edges, and receive packets by the fan-out.
    is_hub: bool,
    /// `None` unless the edge learns what the links of its members take.
    pacing: Option<Pacing>,
}

/// Control bytes that the links of an edge's members have taken, and of which the edge does not know.
#[derive(Default)]
struct Pacing {
    is_held: bool,
    taken: Vec<(Peer, usize)>,
}

/// An edge as its members see it.
struct Face(Rc<RefCell<EdgeState>>);

/// A connection of an edge to the owner.
struct Link(Rc<RefCell<EdgeState>>, Peer);

enum StagePeer {
    Member(Box<ClientSession>),
    Link(Link),
}

impl EdgeStage {
    /// A scene of this script without members, and so many edges. `links` are those of members and of edges.
    #[must_use]
    pub fn new(
        script: Box<dyn Script>,
        stepping: Stepping,
        edges: usize,
        links: LinkConfig,
        seed: u64,
    ) -> Self {
        let config = SceneConfig {
            stepping,
            ..script.config()
        };
        let settings = SceneSettings::new(|| Instant::ZERO);
        let mut stage = Self {
            owner: SimNetwork::new(SceneRouter::new(settings), links, seed),
            edges: Vec::new(),
            members: Vec::new(),
            histories: Vec::new(),
            config,
            script,
            scripted: Tick::ZERO,
            commands: Vec::new(),
            seed,
            now: Instant::ZERO,
            dice: Dice::new(seed),
            delayed: Vec::new(),
            fan_out_loss: 0,
        };
        for _ in 0..edges {
            stage.add_edge(Permit::OPEN, links);
        }
        stage
    }

    /// Adds an edge whose members have this permit; returns its number.
    pub fn add_edge(&mut self, permit: Permit, links: LinkConfig) -> usize {
        self.add_edge_within((permit, Limits::default()), None, links)
    }

    /// Adds an edge whose owner is another edge, from which packets come by a fan-out. That one has such edges for
    /// members alone.
    pub fn add_edge_behind(&mut self, hub: usize, permit: Permit, links: LinkConfig) -> usize {
        self.edges[hub].shared.borrow_mut().is_hub = true;
        let edge = self.add_edge(permit, links);
        self.edges[edge].hub = Some(hub);
        edge
    }

    /// Adds an edge that learns what the links of its members take, and sends a MiB of snapshots in a second to each.
    pub fn add_paced_edge(&mut self, permit: Permit, links: LinkConfig) -> usize {
        let limits = Limits {
            snapshot_mib_per_second: 1,
            ..Limits::default()
        };
        self.add_edge_within((permit, limits), Some(Pacing::default()), links)
    }

    fn add_edge_within(
        &mut self,
        (permit, limits): (Permit, Limits),
        pacing: Option<Pacing>,
        links: LinkConfig,
    ) -> usize {
        let settings = EdgeSettings {
            limits,
            token: None,
            permit: Arc::new(permit),
            asks_tokens: false,
            token_life: |_| Some(Span::from_millis(3_600_000)),
        };
        let shared = Rc::new(RefCell::new(EdgeState {
            edge: Edge::new(settings),
            to_owner: BTreeMap::new(),
            is_alive: true,
            is_hub: false,
            pacing,
        }));
        let seed = self.seed ^ (self.edges.len() as u64 + 1) << 32;
        let mut network = SimNetwork::new(Face(Rc::clone(&shared)), links, seed);
        network.run_until(self.now);
        self.edges.push(EdgeNode {
            shared,
            network,
            links: Vec::new(),
            hub: None,
        });
        self.edges.len() - 1
    }

    /// Connects a client and waits for its welcome.
    pub fn connect(&mut self, place: Place) -> usize {
        let session = ClientSession::new(SCENE.parse().expect("a valid scene name"));
        let index = self.members.len();
        let at = self.place(place, session);
        self.members.push((place, at));
        self.histories.push(ObservationHistory::default());
        self.run_until("a welcome", |stage| stage.histories[index].welcomes > 0);
        index
    }

    /// A client that creates the scene and sends its commands: the first member.
    pub fn commander(&mut self, place: Place, choice: StreamChoice, key: Option<SessionKey>) {
        let commander = self.connect(place);
        assert_eq!(commander, 0, "the commander comes first");
        let config = self.config;
        self.session(0).create(config).expect("it is in the lobby");
        self.run_until("the scene", |stage| stage.histories[0].created > 0);
        if let Some(key) = key {
            self.session(0)
                .begin_session(key)
                .expect("it is in the lobby");
        }
        self.join(0, choice);
    }

    /// Makes a connected client a member.
    pub fn join(&mut self, index: usize, choice: StreamChoice) {
        self.session(index)
            .join(choice)
            .expect("it is in the lobby");
        self.run_until("a membership", |stage| {
            stage.histories[index].granted.is_some()
        });
    }

    /// Connects a client and makes it a member.
    pub fn enter(&mut self, place: Place, choice: StreamChoice) -> usize {
        let index = self.connect(place);
        self.join(index, choice);
        index
    }

    /// A member's session.
    pub fn session(&mut self, index: usize) -> &mut ClientSession {
        let (place, at) = self.members[index];
        let peer = match place {
            Place::Edge(edge) => self.edges[edge].network.client_mut(at),
            Place::Owner => self.owner.client_mut(at),
        };
        match peer {
            StagePeer::Member(session) => session,
            StagePeer::Link(_) => unreachable!("members are no links"),
        }
    }

    /// The same, to read.
    #[must_use]
    pub fn client(&self, index: usize) -> &ClientSession {
        let (place, at) = self.members[index];
        let peer = match place {
            Place::Edge(edge) => self.edges[edge].network.client(at),
            Place::Owner => self.owner.client(at),
        };
        match peer {
            StagePeer::Member(session) => session,
            StagePeer::Link(_) => unreachable!("members are no links"),
        }
    }

    /// A member's copy.
    ///
    /// # Panics
    ///
    /// If the client is not a member.
    #[must_use]
    pub fn copy(&self, index: usize) -> &Replica {
        self.client(index).replica().expect("a member has a copy")
    }

    /// The scene's server.
    #[must_use]
    pub fn owner(&self) -> &SceneRouter {
        self.owner.server()
    }

    /// Number of connections that edges have opened to the owner.
    #[must_use]
    pub fn links(&self) -> usize {
        self.edges.iter().map(|edge| edge.links.len()).sum()
    }

    /// Sets all links of the owner, or of an edge's members.
    pub fn set_links(&mut self, place: Place, links: LinkConfig) {
        match place {
            Place::Owner => self.owner.set_config(links),
            Place::Edge(edge) => self.edges[edge].network.set_config(links),
        }
    }

    /// An edge's process is killed, and sends nothing more. Its members notice at once, the owner does not.
    pub fn kill(&mut self, edge: usize) {
        let node = &mut self.edges[edge];
        node.shared.borrow_mut().is_alive = false;
        for client in 0..node.network.clients() {
            node.network.sever(client, Ending::TimedOut);
        }
    }

    /// The connections of an edge to the owner break.
    pub fn cut_off(&mut self, edge: usize) {
        for link in self.edges[edge].links.clone() {
            self.owner.sever(link, Ending::Broken);
        }
    }

    /// The links of a paced edge's members take nothing more.
    pub fn hold_links(&mut self, edge: usize) {
        let mut state = self.edges[edge].shared.borrow_mut();
        state.pacing.get_or_insert_default().is_held = true;
    }

    /// They take what has waited, and everything from now on.
    pub fn release_links(&mut self, edge: usize) {
        let mut state = self.edges[edge].shared.borrow_mut();
        state.pacing.get_or_insert_default().is_held = false;
    }

    /// Sets what an edge's connection of this number receives from the owner.
    pub fn set_link_from_owner(&mut self, edge: usize, number: usize, link: LinkConfig) {
        let index = self.edges[edge].links[number];
        self.owner.set_config_of(index, Direction::Down, link);
    }

    /// A member receives a datagram that was sent long ago.
    pub fn deliver(&mut self, index: usize, datagram: &[u8]) {
        let now = self.now;
        self.session(index).handle_datagram(now, Peer(0), datagram);
    }

    /// A member of an edge sends bytes that its session knows nothing of.
    pub fn write(&mut self, index: usize, bytes: &[u8]) {
        let (Place::Edge(edge), at) = self.members[index] else {
            unreachable!("a member of an edge");
        };
        let mut state = self.edges[edge].shared.borrow_mut();
        let from = Peer(at as u64);
        state.edge.handle_control(self.now, from, bytes);
    }

    /// An edge receives something over its connection of this number that the owner has not sent.
    pub fn deliver_from_owner(&mut self, edge: usize, number: usize, lane: Lane, bytes: &[u8]) {
        let mut state = self.edges[edge].shared.borrow_mut();
        let mut owner = state.edge.owner();
        let link = Peer(number as u64);
        match lane {
            Lane::Control => owner.handle_control(self.now, link, bytes),
            Lane::State => owner.handle_datagram(self.now, link, bytes),
        }
    }

    /// A client whose connection has ended takes its session up elsewhere.
    pub fn resume(&mut self, index: usize, place: Place) {
        let fresh = ClientSession::new(SCENE.parse().expect("a valid scene name"));
        let mut session = std::mem::replace(self.session(index), fresh);
        session.reconnect().expect("it has a session");
        let at = self.place(place, session);
        self.members[index] = (place, at);
    }

    /// The commander sends the next commands of its script.
    pub fn command(&mut self) {
        let mut commands = Vec::new();
        self.script.commands(self.scripted, &mut commands);
        self.scripted = self.scripted.next();
        for command in commands {
            self.send(command);
        }
    }

    /// The commander sends a command.
    pub fn send(&mut self, command: Command) {
        let number = self.session(0).command(command.clone());
        let number = number.expect("scripts send valid commands");
        assert_eq!(number, self.commands.len() as u64);
        self.commands.push(command);
    }

    /// In lockstep: sends the script's commands, steps once, and waits until all members have the complete tick.
    pub fn tick(&mut self) -> Tick {
        self.command();
        let wanted = self.copy(0).stream().complete().next();
        let now = self.now;
        self.session(0)
            .advance(now, wanted)
            .expect("a member may advance");
        self.run_until("a tick", |stage| {
            let members =
                (0..stage.members.len()).filter_map(|index| stage.client(index).replica());
            let mut complete = members.map(|copy| copy.stream().complete());
            complete.all(|complete| complete >= wanted)
        });
        wanted
    }

    /// Lets time pass in small steps.
    pub fn run(&mut self, span: Span) {
        let end = self.now + span;
        while self.now < end {
            self.now = (self.now + INTERVAL).min(end);
            self.owner.run_until(self.now);
            for edge in 0..self.edges.len() {
                self.run_edge(edge);
            }
            self.fan_out();
            self.store_claims();
        }
    }

    fn run_edge(&mut self, edge: usize) {
        let node = &mut self.edges[edge];
        node.network.run_until(self.now);
        node.shared.borrow_mut().report_taken(self.now);
        let (shared, hub) = (Rc::clone(&node.shared), node.hub);
        loop {
            let dial = shared.borrow_mut().edge.poll_dial();
            let Some(dial) = dial else { return };
            let link = StagePeer::Link(Link(Rc::clone(&shared), dial.link));
            let at = match hub {
                Some(hub) => self.edges[hub].network.connect(link),
                None => self.owner.connect(link),
            };
            self.edges[edge].links.push(at);
        }
    }

    /// The fan-out drops, repeats and delays some packets.
    fn fan_out(&mut self) {
        let mut arrived = std::mem::take(&mut self.delayed);
        for (hub, node) in self.edges.iter().enumerate() {
            let mut state = node.shared.borrow_mut();
            while let Some(packet) = state.edge.poll_shared() {
                for (edge, _) in self
                    .edges
                    .iter()
                    .enumerate()
                    .filter(|(_, node)| node.hub == Some(hub))
                {
                    match self.dice.below(100) {
                        lost if lost < self.fan_out_loss => {}
                        95.. => arrived.extend([(edge, packet.clone()), (edge, packet.clone())]),
                        90.. => self.delayed.push((edge, packet.clone())),
                        _ => arrived.push((edge, packet.clone())),
                    }
                }
            }
        }
        for (edge, packet) in arrived {
            let mut state = self.edges[edge].shared.borrow_mut();
            if state.is_alive && state.edge.streams().any(|stream| stream == packet.of) {
                state.edge.handle_shared(self.now, &packet);
            }
        }
    }

    /// Runs the script for this time, with one set of commands per tick of 60 Hz.
    pub fn run_script(&mut self, span: Span) {
        let end = self.now + span;
        while self.now < end {
            self.command();
            self.run(crate::stage::TICK);
        }
    }

    /// Lets time pass until a condition holds.
    ///
    /// # Panics
    ///
    /// If it does not hold in time.
    pub fn run_until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let deadline = self.now + ANSWER_TIME_LIMIT;
        self.store_claims();
        while !done(self) {
            assert!(self.now < deadline, "no {what} within {ANSWER_TIME_LIMIT}");
            self.run(INTERVAL);
        }
    }

    /// The truth up to the newest tick with a claim, after checking that the server agrees with it.
    ///
    /// # Panics
    ///
    /// When the server's checksum differs: then a command was not applied exactly once, in order, at the stated tick.
    pub fn truth(&mut self) -> SceneTruth {
        let sent = self.commands.len() as u64;
        self.run_until("an answer to each command", |stage| {
            let answered = stage.histories[0].applied.last();
            answered.map_or(0, |(through, _)| through + 1) == sent
        });
        let before = self.histories[0].inspections.len();
        self.session(0)
            .inspect()
            .expect("the commander is a member");
        self.run_until("an inspection", |stage| {
            stage.histories[0].inspections.len() > before
        });
        let inspected = self.histories[0].inspections[before];
        let copies = (0..self.members.len()).filter_map(|index| self.client(index).replica());
        let newest = copies.map(|copy| copy.stream().watermark_tick()).max();
        for (index, history) in self.histories.iter().enumerate() {
            assert_eq!(history.mismatches, 0, "member {index}");
        }
        assert_eq!(inspected.mismatches, 0);
        let record = MemberRecord {
            commands: self.commands.clone(),
            applied: self.histories[0].applied.clone(),
        };
        let until = newest.unwrap_or_default().max(inspected.tick);
        let truth = SceneTruth::replay(self.config, &record, until);
        assert_eq!(
            truth.digest(inspected.tick),
            Some(inspected.truth),
            "the server's checksum differs from the truth"
        );
        truth
    }

    fn place(&mut self, place: Place, session: ClientSession) -> usize {
        let member = StagePeer::Member(Box::new(session));
        match place {
            Place::Owner => self.owner.connect(member),
            Place::Edge(edge) => self.edges[edge].network.connect(member),
        }
    }

    fn store_claims(&mut self) {
        for index in 0..self.members.len() {
            let mut history = std::mem::take(&mut self.histories[index]);
            history.take_events(self.session(index));
            history.store_claims(self.client(index));
            self.histories[index] = history;
        }
    }
}

impl EdgeState {
    /// Tells a paced edge what the links of its members have taken.
    fn report_taken(&mut self, now: Instant) {
        if let Some(pacing) = self.pacing.as_mut().filter(|pacing| !pacing.is_held) {
            for (peer, bytes) in pacing.taken.drain(..) {
                self.edge.handle_control_taken(now, peer, bytes);
            }
        }
    }
}

impl Endpoint for Face {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let mut state = self.0.borrow_mut();
        state.edge.handle_opened(now, peer);
        if state.is_hub {
            state.edge.share(peer);
        }
        if state.pacing.is_some() {
            state.edge.handle_control_taken(now, peer, 0);
        }
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.0.borrow_mut().edge.handle_control(now, from, bytes);
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.0.borrow_mut().edge.handle_datagram(now, from, bytes);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        let mut state = self.0.borrow_mut();
        if state.is_alive {
            state.edge.handle_ended(now, peer, ending);
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.0.borrow_mut().edge.handle_timeout(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let mut state = self.0.borrow_mut();
        let transmit = state.is_alive.then(|| state.edge.poll_transmit())?;
        if let (Some(pacing), Some(Transmit::Control { to, bytes })) =
            (&mut state.pacing, &transmit)
        {
            pacing.taken.push((*to, bytes.len()));
        }
        transmit
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let state = self.0.borrow();
        state.is_alive.then(|| state.edge.poll_timeout())?
    }
}

impl Link {
    fn with(&self, act: impl FnOnce(&mut Edge)) {
        let mut state = self.0.borrow_mut();
        if state.is_alive {
            act(&mut state.edge);
        }
    }

    fn poll(&self) -> Option<Transmit> {
        let mut state = self.0.borrow_mut();
        if !state.is_alive {
            return None;
        }
        while let Some(transmit) = state.edge.owner().poll_transmit() {
            let to = match &transmit {
                Transmit::Control { to, .. }
                | Transmit::State { to, .. }
                | Transmit::Close { to, .. } => *to,
            };
            state.to_owner.entry(to).or_default().push_back(transmit);
        }
        state.to_owner.get_mut(&self.1)?.pop_front()
    }
}

impl Endpoint for StagePeer {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        match self {
            Self::Member(session) => session.handle_opened(now, peer),
            Self::Link(link) => link.with(|edge| edge.owner().handle_opened(now, link.1)),
        }
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        match self {
            Self::Member(session) => session.handle_control(now, from, bytes),
            Self::Link(link) => link.with(|edge| edge.owner().handle_control(now, link.1, bytes)),
        }
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        match self {
            Self::Member(session) => session.handle_datagram(now, from, bytes),
            Self::Link(link) => link.with(|edge| edge.owner().handle_datagram(now, link.1, bytes)),
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        match self {
            Self::Member(session) => session.handle_ended(now, peer, ending),
            Self::Link(link) => link.with(|edge| edge.owner().handle_ended(now, link.1, ending)),
        }
    }

    fn handle_timeout(&mut self, now: Instant) {
        if let Self::Member(session) = self {
            session.handle_timeout(now);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        match self {
            Self::Member(session) => session.poll_transmit(),
            Self::Link(link) => link.poll(),
        }
    }

    fn poll_timeout(&self) -> Option<Wake> {
        match self {
            Self::Member(session) => session.poll_timeout(),
            Self::Link(_) => None,
        }
    }
}
