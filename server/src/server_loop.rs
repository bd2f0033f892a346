//! A server without sockets: connects client connections to scenes.
//!
//! Routes each message to the scene of its connection. The real driver and the simulated network use it alike. It
//! reads no clock but that of its settings, which only measures.

mod creation;
mod owned;
mod storage;
mod turns;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use rhumb_protocol::message::{ClientMessage, Denial, Extension, Grease, ServerMessage};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind};
use rhumb_protocol::scene::{CommandError, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};
use rhumb_reckoning::Tick;

pub use self::owned::OwnedScene;
use crate::admission::SceneSlot;
use crate::authority_table::UpstreamStatistics;
use crate::baking::Bakery;
use crate::empty_scenes::EmptyScenes;
use crate::outbox::Outbox;
use crate::rights::{self, Ownership, Permit, Request};
use crate::scene_connection::SceneConnection;
use crate::scene_runner::{DisconnectReason, SceneRunner};
use crate::settings::SceneSettings;

/// Unread bytes of a connection beyond which the driver is to hold back more.
const UNREAD_BYTES: usize = 64 << 10;

/// All scenes of one server process and all connections to them.
pub struct ServerLoop {
    runners: BTreeMap<SceneName, SceneRunner>,
    connections: BTreeMap<Peer, SceneConnection>,
    /// Connections with unread messages, whose next turn comes at once.
    queued: VecDeque<Peer>,
    /// Connections with unread messages that wait for their link, for a step, or for slower members.
    blocked: BTreeSet<Peer>,
    retry_at: Instant,
    empty_scenes: EmptyScenes,
    settings: Arc<SceneSettings>,
    taken_slots: BTreeMap<SceneName, SceneSlot>,
    out: Outbox,
    scenes_begun: u32,
    bakery: Bakery,
}

impl ServerLoop {
    /// A server without scenes.
    #[must_use]
    pub fn new(settings: impl Into<Arc<SceneSettings>>) -> Self {
        let settings = settings.into();
        Self {
            runners: BTreeMap::new(),
            connections: BTreeMap::new(),
            queued: VecDeque::new(),
            blocked: BTreeSet::new(),
            retry_at: Instant::ZERO,
            empty_scenes: EmptyScenes::default(),
            taken_slots: BTreeMap::new(),
            out: Outbox::new(settings.limits),
            scenes_begun: 0,
            bakery: Bakery::new(settings.bakers.clone()),
            settings,
        }
    }

    /// Sets what a new connection may do, before its first message; without this, everything.
    pub fn set_permit(&mut self, peer: Peer, permit: Arc<Permit>) {
        if let Some(connection) = self.connections.get_mut(&peer) {
            connection.permit = permit;
        }
    }

    /// Bytes of a connection's control stream that were not handled yet.
    #[must_use]
    pub fn unread_bytes(&self, peer: Peer) -> usize {
        self.out.unread_bytes(peer)
    }

    /// Names of the scenes that exist.
    pub fn scenes(&self) -> impl Iterator<Item = &SceneName> {
        self.runners.keys()
    }

    /// Statistics of all bodies of a scene under a member's authority.
    pub fn upstreams(&self, scene: &SceneName) -> impl Iterator<Item = UpstreamStatistics> {
        let runner = self.runners.get(scene).into_iter();
        runner.flat_map(SceneRunner::upstream_statistics)
    }

    /// Ends the membership of a connection that broke the protocol.
    fn end_if_broken(&mut self, peer: Peer) {
        let broken = (self.out.session(peer)).and_then(|session| session.poll_close());
        if let Some(code) = broken {
            tracing::warn!(peer = peer.0, %code, "closing a connection that broke the protocol");
            self.forget(peer);
        }
    }

    /// Ends the membership of a connection, and forgets it.
    fn forget(&mut self, peer: Peer) {
        self.leave(peer, DisconnectReason::Disconnected);
        self.connections.remove(&peer);
        self.queued.retain(|queued| *queued != peer);
        self.blocked.remove(&peer);
    }

    fn scene_of(&self, peer: Peer) -> Option<&SceneRunner> {
        self.runners
            .get(self.connections.get(&peer)?.scene.as_ref()?)
    }

    fn answer_pending(&mut self, peer: Peer) {
        let name = (self.connections.get(&peer)).and_then(|connection| connection.scene.as_ref());
        if let Some(runner) = name.and_then(|name| self.runners.get_mut(name)) {
            runner.answer_pending(&mut self.out);
        }
    }

    /// Ends scenes that have had no member for too long.
    fn expire(&mut self, now: Instant) {
        let Some(empty_for) = self.settings.limits.empty_scene() else {
            return;
        };
        for name in self.empty_scenes.over(now, empty_for) {
            tracing::info!(scene = %name, "a scene had no members for too long");
            self.delete_scene(&name);
        }
    }

    /// Notes whether a scene has members or an owner.
    fn note_empty(&mut self, name: &SceneName) {
        let runner = self.runners.get(name);
        let is_empty = runner.is_some_and(SceneRunner::is_abandoned);
        self.empty_scenes.note(name, is_empty, self.out.now());
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
            if let Ok(ClientMessage::Hello {
                scene, extensions, ..
            }) = message
            {
                let token = extensions.value(Extension::TOKEN);
                let role = token.map(|_| connection.permit.role);
                connection.scene = Some(scene.clone());
                self.begin_if_provided(&scene);
                let config = self.runners.get(&scene).map(|runner| *runner.config());
                if let Some(session) = self.out.session(peer) {
                    session.welcome(config, role);
                }
            }
            return;
        };
        let permit = Arc::clone(&connection.permit);
        match message {
            Ok(ClientMessage::Create(config)) => {
                let allowed = may(&permit, Request::Create(&config));
                let answer = match allowed.and_then(|()| self.create_stored(&name, config)) {
                    Ok(()) => ServerMessage::Created,
                    Err(denial) => ServerMessage::Denied(denial),
                };
                self.out.send(peer, &answer);
            }
            Ok(ClientMessage::Join(choice)) => {
                let session = connection.session.take();
                let joined = match self.runners.get_mut(&name) {
                    Some(runner) => {
                        let choice = (choice, session);
                        runner.join(now, peer, permit, choice, &mut self.out)
                    }
                    None => Err(self.absence(&name)),
                };
                match joined {
                    Ok(()) => {
                        self.note_member(peer);
                        self.note_empty(&name);
                    }
                    Err(denial) => self.out.send(peer, &ServerMessage::Denied(denial)),
                }
            }
            Ok(ClientMessage::Session(request)) => connection.session = Some(request),
            Ok(ClientMessage::Delete) => match may(&permit, Request::Delete) {
                Ok(()) => self.delete(peer, &name),
                Err(denial) => self.out.send(peer, &ServerMessage::Denied(denial)),
            },
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
                runner.leave(now, peer, DisconnectReason::Left);
                out.send(peer, &ServerMessage::Left);
                if let Some(connection) = self.connections.get_mut(&peer) {
                    connection.member = false;
                }
                self.note_empty(name);
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

    fn delete(&mut self, peer: Peer, name: &SceneName) {
        if self.runners.get(name).is_some_and(SceneRunner::is_owned) {
            let denial = ServerMessage::Denied(Denial::Owned);
            return self.out.send(peer, &denial);
        }
        if (self.settings.store.as_ref()).is_some_and(|store| store.delete_damaged(name)) {
            return self.out.send(peer, &ServerMessage::Deleted);
        }
        if !self.runners.contains_key(name) {
            let denial = ServerMessage::Denied(Denial::NoSuchScene);
            return self.out.send(peer, &denial);
        }
        let connection = self.connections.get(&peer);
        let is_member_request = connection.is_some_and(|connection| connection.member);
        self.delete_scene(name);
        if !is_member_request {
            self.out.send(peer, &ServerMessage::Deleted);
        }
    }

    /// Removes a scene and informs its members.
    fn delete_scene(&mut self, name: &SceneName) {
        let Some(runner) = self.runners.remove(name) else {
            return;
        };
        for member in runner.members() {
            if let Some(connection) = self.connections.get_mut(&member) {
                connection.member = false;
            }
        }
        runner.end(&mut self.out);
        self.taken_slots.remove(name);
        self.empty_scenes.note(name, false, self.out.now());
        tracing::info!(scene = %name, "scene deleted");
    }

    /// The scene runner of a member.
    fn runner_of(&mut self, peer: Peer) -> Option<&mut SceneRunner> {
        let connection = self.connections.get(&peer)?;
        let name = connection.scene.as_ref().filter(|_| connection.member)?;
        self.runners.get_mut(name)
    }

    fn leave(&mut self, peer: Peer, reason: DisconnectReason) {
        let now = self.out.now();
        let Some(runner) = self.runner_of(peer) else {
            return;
        };
        runner.leave(now, peer, reason);
        let connection = self.connections.get(&peer);
        if let Some(name) = connection.and_then(|connection| connection.scene.clone()) {
            self.note_empty(&name);
        }
    }
}

/// Decides about a request that concerns nothing within a scene.
fn may(permit: &Permit, request: Request<'_>) -> Result<(), Denial> {
    Ok(rights::check(permit, &Ownership::default(), request)?)
}

impl Endpoint for ServerLoop {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.out.at(now);
        (self.connections).insert(peer, SceneConnection::default());
        // Any number will do that is seldom repeated.
        let seed = now.as_nanos() ^ peer.0.rotate_left(48);
        self.out.open(peer, Grease::new(seed));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.out.receive(now, from, bytes.len());
        if let Some(session) = self.out.session(from) {
            session.handle_control(bytes);
        }
        if !self.queued.contains(&from) && !self.blocked.contains(&from) {
            self.take_turn(now, from);
        }
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.out.at(now);
        self.out.note_taken(peer, bytes);
        if bytes > 0 {
            self.answer_pending(peer);
            self.retry(now);
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.out.unread_bytes(from) < UNREAD_BYTES
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.out.receive(now, from, bytes.len());
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
        self.out.at(now);
        if self.out.close_if_stalled(peer) {
            return;
        }
        let Some(connection) = self.connections.get(&peer).filter(|c| c.member) else {
            return;
        };
        let name = connection.scene.as_ref();
        if let Some(runner) = name.and_then(|name| self.runners.get_mut(name)) {
            runner.handle_link_report(now, peer, report, &mut self.out);
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        tracing::debug!(peer = peer.0, ?ending, "connection ended");
        self.out.at(now);
        let reason = match ending {
            Ending::Closed(code) if code == CloseCode::DONE.0 => DisconnectReason::Left,
            Ending::Closed(_) | Ending::TimedOut | Ending::Broken => DisconnectReason::Disconnected,
        };
        self.handle_rest(now, peer, reason);
        self.answer_pending(peer);
        self.leave(peer, reason);
        self.forget(peer);
        self.out.forget(peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.out.at(now);
        for peer in std::mem::take(&mut self.queued) {
            self.take_turn(now, peer);
        }
        for runner in self.runners.values_mut() {
            self.settings.heartbeat.beat();
            runner.handle_timeout(now, &mut self.out);
            if runner.next_snapshot(&self.out).is_some_and(|at| at <= now) {
                runner.answer_pending(&mut self.out);
            }
        }
        self.retry(now);
        self.expire(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.out.poll()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let wake = |at, reason| Wake { at, reason };
        let steps = self.runners.values().filter_map(SceneRunner::next_step);
        let step = steps.min().map(|at| wake(at, WakeReason::Tick));
        let input = (!self.queued.is_empty()).then(|| wake(Instant::ZERO, WakeReason::Input));
        let retry = (!self.blocked.is_empty()).then(|| wake(self.retry_at, WakeReason::Input));
        let snapshots =
            (self.runners.values()).filter_map(|runner| runner.next_snapshot(&self.out));
        let snapshot = snapshots.min().map(|at| wake(at, WakeReason::Snapshot));
        let expires =
            (self.settings.limits.empty_scene()).and_then(|after| self.empty_scenes.next(after));
        let expires = expires.map(|at| wake(at, WakeReason::Deadline));
        [step, input, retry, snapshot, expires]
            .into_iter()
            .flatten()
            .min_by_key(|wake| wake.at)
    }
}
