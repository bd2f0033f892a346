//! A server and its clients in one process, with immediate delivery.
//!
//! There is no network, and time passes only in `pass`. Clients are real sessions or raw peers.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::session::{ClientSession, CloseCode};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_scene::engine::Engines;
use rhumb_scene::{Feeds, Hooks, Limits, ProvidedScenes, SceneRouter, SceneSettings};

/// One unit of data between the server and a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Delivered {
    /// Bytes of the control stream.
    Control(Bytes),
    /// A datagram.
    State(Bytes),
}

/// The fate of a datagram from the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeliveryAction {
    /// It is delivered.
    Arrives,
    /// It is lost.
    Lost,
    /// It is delivered twice.
    Twice,
    /// It is delivered after the next one.
    Late,
}

/// Selects the fate of each datagram.
pub struct LossFilter(Box<dyn FnMut(&Bytes) -> DeliveryAction>);

impl LossFilter {
    /// A filter from a function.
    pub fn new(action: impl FnMut(&Bytes) -> DeliveryAction + 'static) -> Self {
        Self(Box::new(action))
    }
}

/// A server with its clients.
pub struct Table {
    server: SceneRouter,
    now: Instant,
    /// Real sessions by their peer.
    sessions: BTreeMap<Peer, ClientSession>,
    /// Data that the server sent to each peer and that was not taken yet.
    inbox: BTreeMap<Peer, Vec<Delivered>>,
    /// Data that each session sent and that was not taken yet.
    outbox: BTreeMap<Peer, Vec<Delivered>>,
    closed: BTreeMap<Peer, CloseCode>,
    /// Filters of datagrams from the server, by receiver.
    downlink_filters: BTreeMap<Peer, LossFilter>,
    late: BTreeMap<Peer, Bytes>,
    /// Filters of datagrams to the server, by sender; every action except `Arrives` loses the datagram.
    uplink_filters: BTreeMap<Peer, LossFilter>,
    /// Those whose links report what they take, as real ones do.
    paced: BTreeSet<Peer>,
    /// What the server sent to those whose downlink is held.
    held: BTreeMap<Peer, Vec<Delivered>>,
    next: u64,
}

/// The server's name in each session.
const HOST: Peer = Peer(0);

impl Default for Table {
    fn default() -> Self {
        Self::with(SceneSettings::new(|| Instant::ZERO))
    }
}

impl Table {
    /// A server of these settings.
    #[must_use]
    pub fn with(settings: SceneSettings) -> Self {
        Self {
            server: SceneRouter::new(settings),
            now: Instant::ZERO,
            sessions: BTreeMap::new(),
            inbox: BTreeMap::new(),
            outbox: BTreeMap::new(),
            closed: BTreeMap::new(),
            downlink_filters: BTreeMap::new(),
            late: BTreeMap::new(),
            uplink_filters: BTreeMap::new(),
            paced: BTreeSet::new(),
            held: BTreeMap::new(),
            next: 0,
        }
    }

    /// A server whose scenes have these hooks.
    #[must_use]
    pub fn with_hooks(hooks: Hooks) -> Self {
        Self::with(SceneSettings {
            hooks: Some(hooks),
            ..SceneSettings::new(|| Instant::ZERO)
        })
    }

    /// A server that provides these scenes.
    #[must_use]
    pub fn with_provided(scenes: ProvidedScenes) -> Self {
        Self::with(SceneSettings {
            provided: Some(scenes),
            ..SceneSettings::new(|| Instant::ZERO)
        })
    }

    /// A server whose scenes have these engines.
    #[must_use]
    pub fn with_engines(engines: Engines) -> Self {
        Self::with(SceneSettings {
            engines,
            ..SceneSettings::new(|| Instant::ZERO)
        })
    }

    /// A server with these limits.
    #[must_use]
    pub fn with_limits(limits: Limits) -> Self {
        Self::with(SceneSettings {
            limits,
            ..SceneSettings::new(|| Instant::ZERO)
        })
    }

    /// The feeds of the server's scenes.
    #[must_use]
    pub fn feeds(&self) -> Feeds {
        self.server.feeds()
    }

    /// Connects a new session to the server.
    pub fn connect(&mut self, scene: &str) -> Peer {
        let peer = self.connect_raw_peer();
        let name = scene.parse().expect("a valid scene name");
        let mut session = ClientSession::new(name);
        session.handle_opened(self.now, HOST);
        self.sessions.insert(peer, session);
        self.run_until_idle();
        peer
    }

    /// Connects a client that creates a scene and joins it.
    ///
    /// # Panics
    ///
    /// If the server does not welcome it.
    pub fn create(&mut self, scene: &str, config: SceneConfig, choice: StreamChoice) -> Peer {
        let peer = self.connect(scene);
        let session = self.session(peer);
        session.create(config).expect("the session is in the lobby");
        session.join(choice).expect("the session is in the lobby");
        self.run_until_idle();
        peer
    }

    /// Opens a connection without a session, for raw bytes.
    pub fn connect_raw_peer(&mut self) -> Peer {
        let peer = Peer(self.next);
        self.next += 1;
        self.server.handle_opened(self.now, peer);
        peer
    }

    /// The session of a peer.
    ///
    /// # Panics
    ///
    /// If the peer has no session.
    pub fn session(&mut self, peer: Peer) -> &mut ClientSession {
        self.sessions.get_mut(&peer).expect("a connected session")
    }

    /// The current time.
    #[must_use]
    pub const fn now(&self) -> Instant {
        self.now
    }

    /// Delivers control bytes to the server.
    pub fn control(&mut self, from: Peer, bytes: &[u8]) {
        self.server.handle_control(self.now, from, bytes);
        self.run_until_idle();
    }

    /// Delivers a datagram to the server.
    pub fn datagram(&mut self, from: Peer, bytes: &[u8]) {
        self.server.handle_datagram(self.now, from, bytes);
        self.run_until_idle();
    }

    /// Makes the link of a connection report from now on what it takes, which is everything at once.
    pub fn pace(&mut self, peer: Peer) {
        self.paced.insert(peer);
        self.server.handle_control_taken(self.now, peer, 0);
    }

    /// Holds back what the server sends to a peer, until [`Self::release`].
    pub fn hold(&mut self, peer: Peer) {
        self.held.entry(peer).or_default();
    }

    /// Delivers what was held back, in its order.
    pub fn release(&mut self, peer: Peer) {
        let held = self.held.remove(&peer).unwrap_or_default();
        held.into_iter().for_each(|sent| self.arrive(peer, sent));
        self.run_until_idle();
    }

    /// Filters datagrams from the server to a peer from now on.
    pub fn filter_downlink(&mut self, peer: Peer, filter: LossFilter) {
        self.downlink_filters.insert(peer, filter);
    }

    /// Filters datagrams from a session to the server from now on.
    pub fn filter_uplink(&mut self, peer: Peer, filter: LossFilter) {
        self.uplink_filters.insert(peer, filter);
    }

    /// Breaks a connection.
    pub fn end(&mut self, peer: Peer) {
        self.server.handle_ended(self.now, peer, Ending::Broken);
        if let Some(mut session) = self.sessions.remove(&peer) {
            session.handle_ended(self.now, HOST, Ending::Broken);
        }
        self.run_until_idle();
    }

    /// Breaks a connection, and keeps its session for [`Self::reconnect`].
    ///
    /// # Panics
    ///
    /// If the peer has no session.
    pub fn end_connection(&mut self, peer: Peer) {
        self.server.handle_ended(self.now, peer, Ending::Broken);
        let now = self.now;
        self.session(peer).handle_ended(now, HOST, Ending::Broken);
        self.run_until_idle();
    }

    /// Resumes a session whose connection has ended over another one.
    ///
    /// # Panics
    ///
    /// If the peer has no session to resume.
    pub fn reconnect(&mut self, peer: Peer) -> Peer {
        let peer = self.reconnect_until(peer, |_| false);
        self.run_until_idle();
        peer
    }

    /// The same, until the session is as wanted or nothing more arrives.
    ///
    /// # Panics
    ///
    /// As [`Self::reconnect`].
    pub fn reconnect_until(
        &mut self,
        peer: Peer,
        is_wanted: impl Fn(&ClientSession) -> bool,
    ) -> Peer {
        let mut session = (self.sessions.remove(&peer)).expect("a session");
        session.reconnect().expect("that of a member with a key");
        let peer = self.connect_raw_peer();
        session.handle_opened(self.now, HOST);
        self.sessions.insert(peer, session);
        while !is_wanted(self.session(peer)) {
            let sent = self.server.poll_transmit();
            let is_quiet = sent.is_none() && !self.drain_session(peer);
            if is_quiet {
                break;
            }
            sent.into_iter().for_each(|sent| self.hand_over(sent));
        }
        peer
    }

    /// Lets time pass, and fires the timeouts that become due.
    pub fn pass(&mut self, span: Span) {
        let end = self.now + span;
        while let Some(at) = self.next_wake().filter(|at| *at <= end) {
            self.now = self.now.max(at);
            self.run_until_idle();
        }
        self.now = end;
        self.run_until_idle();
    }

    /// The code with which the server closed a connection, if it did.
    #[must_use]
    pub fn closed(&self, peer: Peer) -> Option<CloseCode> {
        self.closed.get(&peer).copied()
    }

    /// The data that the server sent to a peer since the last call.
    pub fn take_received(&mut self, peer: Peer) -> Vec<Delivered> {
        self.inbox.remove(&peer).unwrap_or_default()
    }

    /// The data that a session sent since the last call.
    pub fn take_sent(&mut self, peer: Peer) -> Vec<Delivered> {
        self.outbox.remove(&peer).unwrap_or_default()
    }

    fn next_wake(&self) -> Option<Instant> {
        let session_wakes = self.sessions.values().filter_map(Endpoint::poll_timeout);
        let wakes = session_wakes.chain(self.server.poll_timeout());
        wakes.map(|wake| wake.at).min()
    }

    /// Delivers data until no endpoint has anything to send or to do now.
    pub fn run_until_idle(&mut self) {
        loop {
            let mut quiet = true;
            while let Some(transmit) = self.server.poll_transmit() {
                quiet = false;
                self.hand_over(transmit);
            }
            let peers: Vec<_> = self.sessions.keys().copied().collect();
            for peer in peers {
                quiet &= !self.drain_session(peer);
            }
            if quiet && self.next_wake().is_none_or(|at| at > self.now) {
                return;
            }
            self.wake();
        }
    }

    fn wake(&mut self) {
        let now = self.now;
        let due =
            |endpoint: &dyn Endpoint| endpoint.poll_timeout().is_some_and(|wake| wake.at <= now);
        if due(&self.server) {
            self.server.handle_timeout(now);
        }
        for session in self.sessions.values_mut() {
            if due(session) {
                session.handle_timeout(now);
            }
        }
    }

    fn hand_over(&mut self, transmit: Transmit) {
        let (to, sent) = match transmit {
            Transmit::Control { to, bytes } => {
                if self.paced.contains(&to) {
                    self.server.handle_control_taken(self.now, to, bytes.len());
                }
                (to, Delivered::Control(bytes))
            }
            Transmit::State { to, bytes } => return self.hand_over_datagram(to, bytes),
            Transmit::Close { to, code } => {
                self.closed.insert(to, CloseCode(code));
                if let Some(session) = self.sessions.get_mut(&to) {
                    session.handle_ended(self.now, HOST, Ending::Closed(code));
                }
                return self.server.handle_ended(self.now, to, Ending::Closed(code));
            }
        };
        self.arrive(to, sent);
    }

    fn hand_over_datagram(&mut self, to: Peer, bytes: Bytes) {
        let action = self
            .downlink_filters
            .get_mut(&to)
            .map(|filter| filter.0(&bytes));
        let late = self.late.remove(&to);
        match action.unwrap_or(DeliveryAction::Arrives) {
            DeliveryAction::Arrives => self.arrive(to, Delivered::State(bytes)),
            DeliveryAction::Lost => {}
            DeliveryAction::Twice => {
                self.arrive(to, Delivered::State(bytes.clone()));
                self.arrive(to, Delivered::State(bytes));
            }
            DeliveryAction::Late => {
                self.late.insert(to, bytes);
            }
        }
        if let Some(bytes) = late {
            self.arrive(to, Delivered::State(bytes));
        }
    }

    fn arrive(&mut self, to: Peer, sent: Delivered) {
        if let Some(held) = self.held.get_mut(&to) {
            return held.push(sent);
        }
        if let Some(session) = self.sessions.get_mut(&to) {
            match &sent {
                Delivered::Control(bytes) => session.handle_control(self.now, HOST, bytes),
                Delivered::State(bytes) => session.handle_datagram(self.now, HOST, bytes),
            }
        }
        self.inbox.entry(to).or_default().push(sent);
    }

    /// Delivers the data of a session; returns whether there was any.
    fn drain_session(&mut self, peer: Peer) -> bool {
        let mut any = false;
        while let Some(transmit) = self
            .sessions
            .get_mut(&peer)
            .and_then(ClientSession::poll_transmit)
        {
            any = true;
            let sent = match transmit {
                Transmit::Control { bytes, .. } => {
                    self.server.handle_control(self.now, peer, &bytes);
                    Delivered::Control(bytes)
                }
                Transmit::State { bytes, .. } => {
                    let action = self
                        .uplink_filters
                        .get_mut(&peer)
                        .map(|filter| filter.0(&bytes));
                    if action.is_none_or(|action| action == DeliveryAction::Arrives) {
                        self.server.handle_datagram(self.now, peer, &bytes);
                    }
                    Delivered::State(bytes)
                }
                Transmit::Close { code, .. } => {
                    self.server
                        .handle_ended(self.now, peer, Ending::Closed(code));
                    continue;
                }
            };
            self.outbox.entry(peer).or_default().push(sent);
        }
        any
    }
}
