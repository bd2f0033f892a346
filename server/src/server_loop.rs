//! A server without sockets: connects client connections to scenes.
//!
//! Routes each message to the scene of its connection. The real driver and the simulated network use it alike. It
//! reads no clock but its stopwatch, which only measures.

use std::collections::BTreeMap;

use rhumb_protocol::limits::SCENES_MAX;
use rhumb_protocol::message::{ClientMessage, Denial, Grease, ServerMessage};
use rhumb_protocol::packet::{Datagram, LargestPacket, LossReport, PacketKind};
use rhumb_protocol::scene::{CommandError, SceneConfig, SceneName};
use rhumb_protocol::session::ServerSession;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};
use rhumb_reckoning::Tick;

use crate::app::{AppOptions, Guests};
use crate::authority_table::UpstreamStatistics;
use crate::engine::Workers;
use crate::hook::Hooks;
use crate::outbox::Outbox;
use crate::scene::Scene;
use crate::scene_runner::SceneRunner;
use crate::stream_names::StreamNames;

/// The scene of a connection, and whether its client is a member.
#[derive(Debug)]
struct Connection {
    scene: Option<SceneName>,
    member: bool,
}

/// All scenes of one server process and all connections to them.
pub struct ServerLoop {
    pub(crate) runners: BTreeMap<SceneName, SceneRunner>,
    connections: BTreeMap<Peer, Connection>,
    pub(crate) out: Outbox,
    pub(crate) guests: Guests,
    scenes_begun: u32,
    hooks: Option<Hooks>,
    workers: Workers,
    largest_packet: LargestPacket,
    pub(crate) stopwatch: Box<dyn Fn() -> Instant + Send>,
}

impl ServerLoop {
    /// A server without scenes. `stopwatch` measures the stages of a tick; it need not be the clock of the driver.
    pub fn new(stopwatch: impl Fn() -> Instant + Send + 'static) -> Self {
        Self {
            runners: BTreeMap::new(),
            connections: BTreeMap::new(),
            out: Outbox::default(),
            guests: Guests::default(),
            scenes_begun: 0,
            hooks: None,
            workers: Workers::default(),
            largest_packet: LargestPacket::DEFAULT,
            stopwatch: Box::new(stopwatch),
        }
    }

    /// Sets the hooks of later scenes.
    pub fn attach(&mut self, hooks: Hooks) {
        self.hooks = Some(hooks);
    }

    /// Sets the options for APP clients.
    pub fn configure_app(&mut self, options: AppOptions) {
        self.guests.configure(options);
    }

    /// Sets the threads that step later scenes.
    pub fn employ(&mut self, workers: Workers) {
        self.workers = workers;
    }

    /// Bounds the packets of later scenes' streams.
    pub const fn set_largest_packet(&mut self, largest_packet: LargestPacket) {
        self.largest_packet = largest_packet;
    }

    /// Names of the scenes that exist.
    pub fn scenes(&self) -> impl Iterator<Item = &SceneName> {
        self.runners.keys()
    }

    /// Statistics of all bodies of a scene under a member's authority.
    pub fn drives(&self, scene: &SceneName) -> impl Iterator<Item = UpstreamStatistics> {
        let runner = self.runners.get(scene).into_iter();
        runner.flat_map(SceneRunner::upstream_statistics)
    }

    fn handle_message(
        &mut self,
        now: Instant,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
    ) {
        let Some(connection) = self.connections.get_mut(&peer) else {
            return;
        };
        let Some(name) = connection.scene.clone() else {
            if let Ok(ClientMessage::Hello { scene, .. }) = message {
                let config = self.runners.get(&scene).map(|runner| *runner.config());
                connection.scene = Some(scene);
                if let Some(session) = self.out.session(peer) {
                    session.welcome(config);
                }
            }
            return;
        };
        match message {
            Ok(ClientMessage::Create(config)) => {
                let answer = match self.create(&name, config) {
                    Ok(()) => ServerMessage::Created,
                    Err(denial) => ServerMessage::Denied(denial),
                };
                self.out.send(peer, &answer);
            }
            Ok(ClientMessage::Join(choice)) => {
                let joined = match self.runners.get_mut(&name) {
                    Some(runner) => runner.join(now, peer, choice, &mut self.out),
                    None => Err(Denial::NoSuchScene),
                };
                match joined {
                    Ok(()) => self.note_member(peer),
                    Err(denial) => self.out.send(peer, &ServerMessage::Denied(denial)),
                }
            }
            Ok(ClientMessage::Delete) => self.delete(peer, &name),
            message => self.handle_scene_message(now, peer, &name, message),
        }
    }

    /// A member's message to its scene, or a ping, which any client may send.
    fn handle_scene_message(
        &mut self,
        now: Instant,
        peer: Peer,
        name: &SceneName,
        message: Result<ClientMessage, CommandError>,
    ) {
        let out = &mut self.out;
        let Some(runner) = self.runners.get_mut(name) else {
            let answer = match message {
                Ok(ClientMessage::Ping { sent }) => ServerMessage::Pong {
                    sent,
                    tick: Tick::ZERO,
                    since_tick_ns: 0,
                },
                _ => ServerMessage::Denied(Denial::NoSuchScene),
            };
            return out.send(peer, &answer);
        };
        // Answers keep the order of messages: pending commands are answered first.
        if matches!(
            message,
            Ok(ClientMessage::Leave
                | ClientMessage::Reserve { .. }
                | ClientMessage::Ping { .. }
                | ClientMessage::Inspect)
        ) {
            runner.answer_pending(out);
        }
        match message {
            Ok(ClientMessage::Leave) => {
                runner.leave(peer);
                out.send(peer, &ServerMessage::Left);
                if let Some(connection) = self.connections.get_mut(&peer) {
                    connection.member = false;
                }
            }
            Ok(ClientMessage::Reserve { count }) => runner.reserve(peer, count, out),
            Ok(ClientMessage::Resync(cause)) => runner.resync(peer, cause),
            Ok(ClientMessage::Subscribe(choice)) => runner.subscribe(peer, choice),
            Ok(ClientMessage::Subscribed(stream)) => runner.subscribed(peer, stream),
            Ok(ClientMessage::TierPolicy(tier_policy)) => runner.set_tier_policy(peer, tier_policy),
            Ok(ClientMessage::Ping { sent }) => runner.pong(now, peer, sent, out),
            Ok(ClientMessage::Inspect) => runner.inspect(peer, out),
            message => runner.handle_ordered(peer, message, out),
        }
    }

    fn note_member(&mut self, peer: Peer) {
        if let Some(connection) = self.connections.get_mut(&peer) {
            connection.member = true;
        }
    }

    pub(crate) fn create(&mut self, name: &SceneName, config: SceneConfig) -> Result<(), Denial> {
        if self.runners.contains_key(name) {
            return Err(Denial::SceneExists);
        }
        if self.runners.len() >= SCENES_MAX {
            return Err(Denial::TooManyScenes);
        }
        let scene = Scene::on(config, &self.workers).map_err(Denial::InvalidConfig)?;
        let names = StreamNames::of_scene(self.scenes_begun);
        let mut runner = SceneRunner::new(scene, names);
        runner.set_largest_packet(self.largest_packet);
        if let Some(hook) = self
            .hooks
            .as_mut()
            .and_then(|hooks| hooks.of(name, &config))
        {
            runner.attach(hook);
        }
        self.scenes_begun = self.scenes_begun.wrapping_add(1);
        self.runners.insert(name.clone(), runner);
        tracing::info!(scene = %name, "scene created");
        Ok(())
    }

    fn delete(&mut self, peer: Peer, name: &SceneName) {
        if self.runners.get(name).is_some_and(SceneRunner::is_led) {
            let denial = ServerMessage::Denied(Denial::Led);
            return self.out.send(peer, &denial);
        }
        if !self.runners.contains_key(name) {
            let denial = ServerMessage::Denied(Denial::NoSuchScene);
            return self.out.send(peer, &denial);
        }
        let connection = self.connections.get(&peer);
        let is_member_request = connection.is_some_and(|connection| connection.member);
        self.end_scene(name);
        if !is_member_request {
            self.out.send(peer, &ServerMessage::Deleted);
        }
    }

    /// Removes a scene and informs its members.
    pub(crate) fn end_scene(&mut self, name: &SceneName) {
        let Some(runner) = self.runners.remove(name) else {
            return;
        };
        for member in runner.members() {
            if let Some(connection) = self.connections.get_mut(&member) {
                connection.member = false;
            }
        }
        runner.end(&mut self.out);
        tracing::info!(scene = %name, "scene deleted");
    }

    /// The scene runner of a member.
    fn runner_of(&mut self, peer: Peer) -> Option<&mut SceneRunner> {
        let connection = self.connections.get(&peer)?;
        let name = connection.scene.as_ref().filter(|_| connection.member)?;
        self.runners.get_mut(name)
    }

    fn leave(&mut self, peer: Peer) {
        if let Some(runner) = self.runner_of(peer) {
            runner.leave(peer);
        }
    }
}

impl Endpoint for ServerLoop {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let connection = Connection {
            scene: None,
            member: false,
        };
        self.connections.insert(peer, connection);
        // Any number will do that is seldom repeated.
        let seed = now.as_nanos() ^ peer.0.rotate_left(48);
        self.out.open(peer, Grease::new(seed));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(session) = self.out.session(from) {
            session.handle_control(bytes);
        }
        while let Some(message) = self.out.session(from).and_then(ServerSession::poll_message) {
            self.handle_message(now, from, message);
        }
        let broken = self
            .out
            .session(from)
            .and_then(|session| session.poll_close());
        if let Some(code) = broken {
            tracing::warn!(peer = from.0, %code, "closing a connection that broke the protocol");
            self.leave(from);
            self.connections.remove(&from);
        }
        let out = &mut self.out;
        let name = self
            .connections
            .get(&from)
            .and_then(|connection| connection.scene.as_ref());
        if let Some(runner) = name.and_then(|name| self.runners.get_mut(name)) {
            runner.answer_pending(out);
        }
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let Ok(datagram) = Datagram::open(bytes) else {
            return;
        };
        let Some(connection) = self.connections.get(&from).filter(|c| c.member) else {
            return;
        };
        let runner = connection
            .scene
            .as_ref()
            .and_then(|name| self.runners.get_mut(name));
        let Some(runner) = runner else {
            return;
        };
        let stream = datagram.head().stream;
        match datagram.head().kind {
            PacketKind::LossReport => {
                if let Ok(loss_report) = LossReport::decode(datagram.body()) {
                    runner.handle_loss_report(now, from, stream, &loss_report, &mut self.out);
                }
            }
            // All other packets come from the sender of a stream: here, of an upstream.
            _ => runner.handle_upstream_datagram(from, &datagram, &mut self.out),
        }
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        let Some(connection) = self.connections.get(&peer).filter(|c| c.member) else {
            return;
        };
        let name = connection.scene.as_ref();
        if let Some(runner) = name.and_then(|name| self.runners.get_mut(name)) {
            runner.handle_link_report(now, peer, report, &mut self.out);
        }
    }

    fn handle_ended(&mut self, _now: Instant, peer: Peer, ending: Ending) {
        tracing::debug!(peer = peer.0, ?ending, "connection ended");
        self.leave(peer);
        self.connections.remove(&peer);
        self.out.forget(peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        for runner in self.runners.values_mut() {
            runner.handle_timeout(now, &self.stopwatch, &mut self.out);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.poll()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let at = self
            .runners
            .values()
            .filter_map(SceneRunner::next_step)
            .min()?;
        let reason = WakeReason::Tick;
        Some(Wake { at, reason })
    }
}
