//! One scene, and the connections of the clients that name it.
//!
//! It has neither sockets nor threads: a driver hands it what arrives, and moments. The scene may be there or not: a
//! client creates it, a server provides it, a store has it. It reads no clock but that of its settings, which only
//! measures.

mod creation;
mod owned;
mod turns;

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

use rhumb_protocol::message::{
    ClientMessage, Denial, Extension, Grease, ServerMessage, SessionRequest,
};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind};
use rhumb_protocol::scene::{CommandError, SceneName};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake, WakeReason};
use rhumb_reckoning::Tick;

pub use self::owned::OwnedScene;
use crate::admission::SceneSlot;
use crate::authority_table::UpstreamStatistics;
use crate::baking::{Bake, Bakery};
use crate::outbox::Outbox;
use crate::rights::{self, Ownership, Permit, Request};
use crate::scene_runner::{DisconnectReason, SceneRunner};
use crate::settings::SceneSettings;

/// Unread bytes of a connection beyond which the driver is to hold back more.
const UNREAD_BYTES: usize = 64 << 10;

/// One scene, and the connections to it.
pub struct SceneLoop {
    name: SceneName,
    running: Option<RunningScene>,
    connections: BTreeMap<Peer, SceneConnection>,
    /// Connections with unread messages, whose next turn comes at once.
    queued: VecDeque<Peer>,
    /// Connections with unread messages that wait for their link, for a step, or for slower members.
    blocked: BTreeSet<Peer>,
    retry_at: Instant,
    settings: Arc<SceneSettings>,
    out: Outbox,
    /// How often a scene of this name has begun.
    begun: u32,
    bakery: Bakery,
}

/// The scene while it exists.
struct RunningScene {
    runner: SceneRunner,
    /// Held while it exists.
    _slot: SceneSlot,
    /// Since when it has neither members nor an owner.
    empty_since: Option<Instant>,
}

impl SceneLoop {
    /// A scene that does not exist yet.
    #[must_use]
    pub fn new(name: SceneName, settings: Arc<SceneSettings>) -> Self {
        Self {
            name,
            running: None,
            connections: BTreeMap::new(),
            queued: VecDeque::new(),
            blocked: BTreeSet::new(),
            retry_at: Instant::ZERO,
            out: Outbox::new(settings.limits),
            begun: 0,
            bakery: Bakery::new(settings.bakers.clone()),
            settings,
        }
    }

    /// Sets what a new connection may do, before its first message; without this, everything.
    pub fn admit(&mut self, peer: Peer, permit: Arc<Permit>) {
        if let Some(connection) = self.connections.get_mut(&peer) {
            connection.permit = permit;
        }
    }

    /// Bytes of a connection's control stream that were not handled yet.
    #[must_use]
    pub fn unread_bytes(&self, peer: Peer) -> usize {
        self.out.unread_bytes(peer)
    }

    /// True if the scene exists.
    #[must_use]
    pub const fn exists(&self) -> bool {
        self.running.is_some()
    }

    /// True if it has neither connections nor a scene, whole or damaged.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.out.is_empty() && !self.exists() && !self.is_damaged()
    }

    /// Statistics of all bodies under a member's authority.
    pub fn upstreams(&self) -> impl Iterator<Item = UpstreamStatistics> {
        self.runner()
            .into_iter()
            .flat_map(SceneRunner::upstream_statistics)
    }

    fn runner(&self) -> Option<&SceneRunner> {
        self.running.as_ref().map(|running| &running.runner)
    }

    fn runner_mut(&mut self) -> Option<&mut SceneRunner> {
        self.running.as_mut().map(|running| &mut running.runner)
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

    fn answer_pending(&mut self) {
        if let Some(running) = &mut self.running {
            running.runner.answer_pending(&mut self.out);
        }
    }

    /// Ends the scene if it has had no member for too long.
    fn expire(&mut self, now: Instant) {
        if self.expires_at().is_some_and(|at| at <= now) {
            tracing::info!(scene = %self.name, "a scene had no members for too long");
            self.end_scene();
        }
    }

    /// When the scene ends for want of members.
    fn expires_at(&self) -> Option<Instant> {
        let since = self.running.as_ref()?.empty_since?;
        Some(since + self.settings.limits.empty_scene()?)
    }

    /// Notes whether the scene has members or an owner.
    fn note_empty(&mut self) {
        let now = self.out.now();
        if let Some(running) = &mut self.running {
            let is_empty = running.runner.is_abandoned();
            let since = running.empty_since.unwrap_or(now);
            running.empty_since = is_empty.then_some(since);
        }
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
        if !connection.is_greeted {
            if let Ok(ClientMessage::Hello { extensions, .. }) = message {
                connection.is_greeted = true;
                let token = extensions.value(Extension::TOKEN);
                let role = token.map(|_| connection.permit.role);
                self.begin_if_provided();
                let config = self.runner().map(|runner| *runner.config());
                if let Some(session) = self.out.session(peer) {
                    session.welcome(config, role);
                }
            }
            return;
        }
        let permit = Arc::clone(&connection.permit);
        match message {
            Ok(ClientMessage::Create(config)) => {
                let allowed = may(&permit, Request::Create(&config));
                let answer = match allowed.and_then(|()| self.create_stored(config)) {
                    Ok(()) => ServerMessage::Created,
                    Err(denial) => ServerMessage::Denied(denial),
                };
                self.out.send(peer, &answer);
            }
            Ok(ClientMessage::Join(choice)) => {
                let session = connection.session.take();
                let joined = match &mut self.running {
                    Some(RunningScene { runner, .. }) => {
                        let choice = (choice, session);
                        runner.join(now, peer, permit, choice, &mut self.out)
                    }
                    None => Err(self.absence()),
                };
                match joined {
                    Ok(()) => {
                        self.note_member(peer);
                        self.note_empty();
                    }
                    Err(denial) => self.out.send(peer, &ServerMessage::Denied(denial)),
                }
            }
            Ok(ClientMessage::Session(request)) => connection.session = Some(request),
            Ok(ClientMessage::Delete) => match may(&permit, Request::Delete) {
                Ok(()) => self.delete(peer),
                Err(denial) => self.out.send(peer, &ServerMessage::Denied(denial)),
            },
            message => self.handle_scene_message(now, peer, message),
        }
    }

    /// A member's message to its scene, or a ping, which any client may send.
    fn handle_scene_message(
        &mut self,
        now: Instant,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
    ) {
        let out = &mut self.out;
        let Some(RunningScene { runner, .. }) = &mut self.running else {
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
                self.note_empty();
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

    fn delete(&mut self, peer: Peer) {
        if self.runner().is_some_and(SceneRunner::is_owned) {
            let denial = ServerMessage::Denied(Denial::Owned);
            return self.out.send(peer, &denial);
        }
        let store = self.settings.store.as_ref();
        if store.is_some_and(|store| store.delete_damaged(&self.name)) {
            return self.out.send(peer, &ServerMessage::Deleted);
        }
        if !self.exists() {
            let denial = ServerMessage::Denied(Denial::NoSuchScene);
            return self.out.send(peer, &denial);
        }
        let connection = self.connections.get(&peer);
        let is_member_request = connection.is_some_and(|connection| connection.member);
        self.end_scene();
        if !is_member_request {
            self.out.send(peer, &ServerMessage::Deleted);
        }
    }

    /// Removes the scene and informs its members.
    fn end_scene(&mut self) {
        let Some(RunningScene { runner, .. }) = self.running.take() else {
            return;
        };
        for member in runner.members() {
            if let Some(connection) = self.connections.get_mut(&member) {
                connection.member = false;
            }
        }
        runner.end(&mut self.out);
        tracing::info!(scene = %self.name, "scene deleted");
    }

    /// The scene, for a member of it.
    fn runner_of(&mut self, peer: Peer) -> Option<&mut SceneRunner> {
        self.connections.get(&peer).filter(|of| of.member)?;
        self.runner_mut()
    }

    fn leave(&mut self, peer: Peer, reason: DisconnectReason) {
        let now = self.out.now();
        if let Some(runner) = self.runner_of(peer) {
            runner.leave(now, peer, reason);
            self.note_empty();
        }
    }
}

/// Decides about a request that concerns nothing within a scene.
fn may(permit: &Permit, request: Request<'_>) -> Result<(), Denial> {
    Ok(rights::check(permit, &Ownership::default(), request)?)
}

impl Endpoint for SceneLoop {
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
            self.answer_pending();
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
        if !self.connections.get(&from).is_some_and(|of| of.member) {
            return;
        }
        let Some(RunningScene { runner, .. }) = &mut self.running else {
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
        if !self.connections.get(&peer).is_some_and(|of| of.member) {
            return;
        }
        if let Some(RunningScene { runner, .. }) = &mut self.running {
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
        self.answer_pending();
        self.leave(peer, reason);
        self.forget(peer);
        self.out.forget(peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.out.at(now);
        for peer in std::mem::take(&mut self.queued) {
            self.take_turn(now, peer);
        }
        if let Some(RunningScene { runner, .. }) = &mut self.running {
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
        let runner = self.runner();
        let step = runner.and_then(SceneRunner::next_step);
        let step = step.map(|at| wake(at, WakeReason::Tick));
        let input = (!self.queued.is_empty()).then(|| wake(Instant::ZERO, WakeReason::Input));
        let retry = (!self.blocked.is_empty()).then(|| wake(self.retry_at, WakeReason::Input));
        let snapshot = runner.and_then(|runner| runner.next_snapshot(&self.out));
        let snapshot = snapshot.map(|at| wake(at, WakeReason::Snapshot));
        let expires = self.expires_at().map(|at| wake(at, WakeReason::Deadline));
        [step, input, retry, snapshot, expires]
            .into_iter()
            .flatten()
            .min_by_key(|wake| wake.at)
    }
}

/// A connection: its rights, and its membership.
#[derive(Debug)]
pub(crate) struct SceneConnection {
    /// True once its client has said hello.
    pub(crate) is_greeted: bool,
    /// True if its client is a member of the scene.
    pub(crate) member: bool,
    pub(crate) permit: Arc<Permit>,
    /// A join that waits until the link has taken the snapshot before it, or a shape whose solid is being made.
    pub(crate) held: Option<ClientMessage>,
    /// The solid of the held shape.
    pub(crate) bake: Option<Bake>,
    /// The session of its next join.
    pub(crate) session: Option<SessionRequest>,
}

impl Default for SceneConnection {
    /// A connection that may do everything.
    fn default() -> Self {
        Self {
            is_greeted: false,
            member: false,
            permit: Arc::new(Permit::OPEN),
            held: None,
            bake: None,
            session: None,
        }
    }
}
