//! One scene, and the connections of the clients that name it.
//!
//! It has neither sockets nor threads: a driver hands it what arrives, and moments. The scene may be there or not: a
//! client creates it, a server provides it, a store has it. It reads no clock but that of its settings, which only
//! measures.

mod cells;
mod commands;
mod durability;
mod fed;
mod members;
mod tick;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::{ClientMessage, Denial, Extension, Grease, ServerMessage};
use rhumb_protocol::packet::{Datagram, LossReport, PacketKind};
use rhumb_protocol::scene::{CommandError, SceneConfig, SceneName, ShapeId};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{
    Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason,
};
use rhumb_reckoning::Tick;

use crate::baking::Bakery;
use crate::bodies_by_cell::Cells;
use crate::checkpoint::{Checkpoint, CheckpointError, Rollback};
use crate::clients::{AuthorityTable, Clients, Turn};
use crate::engine::{Engine, FedEngine, NoEngine};
use crate::feed::{FedScene, SharedFeed};
use crate::hook::{Hook, SceneObserver, Times};
use crate::load::{self, CommandPace, SceneLoad, SceneSlot};
use crate::member::{Extent, SnapshotRequest, UpstreamStatistics};
use crate::permit::{IdRanges, Ownership, Permit};
use crate::rights;
use crate::scene::Scene;
use crate::sessions::{Durability, RestoredScene, Sessions};
use crate::settings::{SceneScript, SceneSettings};
use crate::streams::{StreamNames, Streams};

/// Unread bytes of a connection beyond which the driver is to hold back more.
const UNREAD_BYTES: usize = 64 << 10;

/// One scene, and the connections to it.
pub struct SceneLoop {
    name: SceneName,
    running: Option<RunningScene>,
    clients: Clients,
    retry_at: Instant,
    /// The time that messages may still take before the next call for ticks.
    turns_left: Span,
    settings: Arc<SceneSettings>,
    /// Number of scenes of this name that have begun.
    begun: u32,
    bakery: Bakery,
}

/// A scene while it exists.
pub(crate) struct RunningScene {
    scene: Scene,
    hook: Option<Hook>,
    script: Option<SceneScript>,
    streams: Streams,
    /// None if the scene is not divided.
    cells: Option<Cells>,
    names: StreamNames,
    id_ranges: IdRanges,
    ownership: Ownership,
    authority_table: AuthorityTable,
    scene_events: u64,
    /// Encoded scene events that the members have not got yet.
    unsent: Vec<u8>,
    /// The encoded event of each shape, which every snapshot shares.
    shape_events: BTreeMap<ShapeId, Bytes>,
    target: Tick,
    /// Messages that wait for the steps of an earlier advance.
    waiting: VecDeque<(Peer, Result<ClientMessage, CommandError>)>,
    next_step: Option<Instant>,
    last_step: Instant,
    /// The commands since then.
    pace: CommandPace,
    times: Times,
    faulted: bool,
    /// The way back if the engine fails.
    rollback: Rollback,
    /// When it was restored lately.
    restored_at: VecDeque<Instant>,
    /// True if the last step of the free-running scene was more than a step late.
    late: bool,
    /// The client that owns the scene, if one does: it alone steps and deletes the scene, which ends with it.
    owner: Option<Peer>,
    /// The feed of its owner, if that feeds it.
    fed: Option<FedScene>,
    settings: Arc<SceneSettings>,
    load: SceneLoad,
    /// Held while it exists.
    _slot: SceneSlot,
    /// Since when it has no members; `None` for one that is kept without them.
    pub(crate) empty_since: Option<Instant>,
    observer: Box<dyn SceneObserver>,
    sessions: Sessions,
    /// Its command log, if it survives the process.
    durability: Option<Durability>,
}

/// End of a membership.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DisconnectReason {
    /// The client has left; its session is over.
    Left,
    /// The connection has ended; its session waits for another one.
    Disconnected,
}

impl SceneLoop {
    /// A scene that does not exist yet.
    #[must_use]
    pub fn new(name: SceneName, settings: Arc<SceneSettings>) -> Self {
        Self {
            name,
            running: None,
            clients: Clients::new(settings.limits),
            retry_at: Instant::ZERO,
            turns_left: load::TURNS_TIME,
            begun: 0,
            bakery: Bakery::new(settings.bakers.clone()),
            settings,
        }
    }

    /// Sets what a new connection may do, before its first message; without this, everything.
    pub fn admit(&mut self, peer: Peer, permit: Arc<Permit>) {
        if let Some(client) = self.clients.get_mut(peer) {
            client.permit = permit;
        }
    }

    /// Bytes of a connection's control stream that were not handled yet.
    #[must_use]
    pub fn unread_bytes(&self, peer: Peer) -> usize {
        self.clients.unread_bytes(peer)
    }

    /// The name that its connections name.
    #[must_use]
    pub const fn name(&self) -> &SceneName {
        &self.name
    }

    /// True if the scene exists.
    #[must_use]
    pub const fn exists(&self) -> bool {
        self.running.is_some()
    }

    /// True if it has neither connections nor a scene, whole or damaged.
    #[must_use]
    pub fn is_idle(&self) -> bool {
        self.clients.is_empty() && !self.exists() && !self.is_damaged()
    }

    /// Statistics of all bodies under a member's authority.
    pub fn upstreams(&self) -> impl Iterator<Item = UpstreamStatistics> {
        (self.running.as_ref().into_iter())
            .flat_map(|running| running.upstream_statistics(&self.clients))
    }

    /// Ends the membership of a connection that broke the protocol.
    fn end_if_broken(&mut self, peer: Peer) {
        let broken = (self.clients.session(peer)).and_then(|session| session.poll_close());
        if let Some(code) = broken {
            tracing::warn!(peer = peer.0, %code, "closing a connection that broke the protocol");
            self.leave(peer, DisconnectReason::Disconnected);
            self.clients.set_turn(peer, Turn::Over);
        }
    }

    fn answer_pending(&mut self) {
        if let Some(running) = &mut self.running {
            running.answer_pending(&mut self.clients);
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

    /// Notes whether the scene has members.
    fn note_empty(&mut self) {
        let now = self.clients.now();
        if let Some(running) = &mut self.running {
            let is_empty = self.clients.member_count() == 0 && !running.is_durable();
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
        let Some(client) = self.clients.get_mut(peer) else {
            return;
        };
        if !client.is_greeted {
            if let Ok(ClientMessage::Hello { extensions, .. }) = message {
                client.is_greeted = true;
                let token = extensions.value(Extension::TOKEN);
                let role = token.map(|_| client.permit.role);
                self.begin_if_provided();
                let config = self.running.as_ref().map(|running| *running.config());
                if let Some(session) = self.clients.session(peer) {
                    session.welcome(config, role);
                }
            }
            return;
        }
        let permit = Arc::clone(&client.permit);
        match message {
            Ok(ClientMessage::Create(config)) => {
                let allowed = rights::create(&permit, &config);
                let answer = match allowed.and_then(|()| self.create_for((peer, &permit), config)) {
                    Ok(()) => ServerMessage::Created,
                    Err(denial) => ServerMessage::Denied(denial),
                };
                self.clients.send(peer, &answer);
            }
            Ok(ClientMessage::Join(choice)) => {
                let session = client.session_request.take();
                let extent = std::mem::replace(&mut client.extent, Extent::Whole);
                let joined = match &mut self.running {
                    Some(running) => {
                        let choice = (choice, extent, session);
                        running.join(now, peer, permit, choice, &mut self.clients)
                    }
                    None => Err(self.absence()),
                };
                match joined {
                    Ok(()) => self.note_empty(),
                    Err(denial) => self.clients.send(peer, &ServerMessage::Denied(denial)),
                }
            }
            Ok(ClientMessage::Session(request)) => client.session_request = Some(request),
            Ok(ClientMessage::JoinCells) => client.extent = Extent::Cells,
            Ok(ClientMessage::Delete) => {
                let owner = self.running.as_ref().and_then(RunningScene::owner);
                match rights::delete(peer, &permit, owner) {
                    Ok(()) => self.delete(peer),
                    Err(denial) => self.clients.send(peer, &ServerMessage::Denied(denial)),
                }
            }
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
        let clients = &mut self.clients;
        let Some(running) = &mut self.running else {
            let answer = match message {
                Ok(ClientMessage::Ping { sent }) => ServerMessage::Pong {
                    sent,
                    tick: Tick::ZERO,
                    since_tick_ns: 0,
                },
                _ => ServerMessage::Denied(Denial::NoSuchScene),
            };
            return clients.send(peer, &answer);
        };
        // Answers keep the order of messages: pending commands are answered first.
        if matches!(
            message,
            Ok(ClientMessage::Leave
                | ClientMessage::Reserve { .. }
                | ClientMessage::Ping { .. }
                | ClientMessage::Inspect)
        ) {
            running.answer_pending(clients);
        }
        match message {
            Ok(ClientMessage::Leave) => {
                running.leave(peer, DisconnectReason::Left, clients);
                clients.send(peer, &ServerMessage::Left);
                self.note_empty();
                self.end_if_owned_by(peer);
            }
            Ok(ClientMessage::Reserve { count }) => running.reserve(peer, count, clients),
            Ok(ClientMessage::Resync(cause)) => running.resync(peer, cause, clients),
            // Of several in one read the last counts.
            Ok(ClientMessage::Subscribe(choice)) => {
                if let Some(member) = clients.member_mut(peer) {
                    member.snapshot_request = Some(SnapshotRequest::Other(choice));
                }
            }
            Ok(ClientMessage::Subscribed(stream)) => running.subscribed(peer, stream, clients),
            Ok(ClientMessage::OfCell { cell, request }) => {
                running.handle_cell_request(peer, cell, request, clients);
            }
            Ok(ClientMessage::TierPolicy(tier_policy)) => {
                if let Some(member) = clients.member_mut(peer) {
                    member.link.set_policy(tier_policy);
                }
            }
            Ok(ClientMessage::Ping { sent }) => running.pong(now, peer, sent, clients),
            Ok(ClientMessage::Inspect) => running.inspect(peer, clients),
            message => running.handle_ordered(peer, message, clients),
        }
    }

    fn delete(&mut self, peer: Peer) {
        let store = self.settings.store.as_ref();
        if store.is_some_and(|store| store.delete_damaged(&self.name)) {
            return self.clients.send(peer, &ServerMessage::Deleted);
        }
        if !self.exists() {
            let denial = ServerMessage::Denied(Denial::NoSuchScene);
            return self.clients.send(peer, &denial);
        }
        let is_member_request = self.clients.member(peer).is_some();
        self.end_scene();
        if !is_member_request {
            self.clients.send(peer, &ServerMessage::Deleted);
        }
    }

    /// Removes the scene and informs its members.
    fn end_scene(&mut self) {
        let Some(running) = self.running.take() else {
            return;
        };
        running.end(&mut self.clients);
        tracing::info!(scene = %self.name, "scene deleted");
    }

    fn leave(&mut self, peer: Peer, reason: DisconnectReason) {
        if let Some(running) = &mut self.running
            && self.clients.member(peer).is_some()
        {
            running.leave(peer, reason, &mut self.clients);
            self.note_empty();
        }
        self.end_if_owned_by(peer);
    }

    /// Ends the scene of a client that leaves it.
    fn end_if_owned_by(&mut self, peer: Peer) {
        if self.running.as_ref().and_then(RunningScene::owner) == Some(peer) {
            self.end_scene();
        }
    }
}

impl SceneLoop {
    /// Begins the scene if the server provides it, unless it is there.
    pub(super) fn begin_if_provided(&mut self) {
        if self.exists() {
            return;
        }
        let provided = self.settings.provided.as_ref();
        let Some(provided) = provided.and_then(|scenes| scenes.of(&self.name)) else {
            return;
        };
        match self.create(provided.config, None) {
            Ok(()) => {
                if let Some(running) = &mut self.running {
                    running.follow_script(provided.script, &mut self.clients);
                }
                self.note_empty();
            }
            Err(denial) => {
                tracing::warn!(scene = %self.name, %denial, "a provided scene cannot begin");
            }
        }
    }

    /// Creates the scene for a client: for one that owns it, or with a log if there is a store. The client that feeds the
    /// scene owns it, and no other one creates it.
    pub(super) fn create_for(
        &mut self,
        (peer, permit): (Peer, &Permit),
        config: SceneConfig,
    ) -> Result<(), Denial> {
        if self.is_damaged() {
            return Err(Denial::SceneFaulted);
        }
        let feed = self.settings.feeds.of(&self.name);
        if feed.as_ref().is_some_and(|feed| feed.owner() != peer) {
            return Err(Denial::NoSuchScene);
        }
        let owner = (permit.owns || feed.is_some()).then_some(peer);
        self.create(config, feed)?;
        if let (Some(owner), Some(running)) = (owner, self.running.as_mut()) {
            running.give_to(owner);
        }
        let store = self.settings.store.as_ref().filter(|_| owner.is_none());
        let log = store.and_then(|store| store.create(&self.name, &config));
        if let (Some(log), Some(running)) = (log, self.running.as_mut()) {
            running.keep_log(log, Span::ZERO);
        }
        self.note_empty();
        Ok(())
    }

    /// Runs the scene that was restored.
    pub fn add_restored(&mut self, restored: RestoredScene) {
        let RestoredScene {
            scene,
            sessions,
            ownership,
            unnoted,
            log,
            took,
        } = restored;
        let Some(slot) = self.settings.take_slot() else {
            return tracing::error!(scene = %self.name, "no place for another scene");
        };
        let mut load = self.settings.load_of(&self.name, scene.config());
        // The bodies were admitted before: a server with lower limits now takes no more of them.
        for _ in 0..scene.body_count() {
            load.add_body();
        }
        let _ = load.set_locomotion(load::locomotion_steps(scene.locomotions()));
        self.run_scene(scene, slot, load);
        let Some(running) = &mut self.running else {
            return;
        };
        running.restore_shapes();
        if let Some(log) = log {
            running.keep_log(log, took);
        }
        running.restore_members(sessions, ownership, unnoted, &mut self.clients);
        self.note_empty();
    }

    /// The state of the scene: everything that its server has read.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a scene that does not exist, and one that cannot be saved.
    pub fn save(&self) -> Result<Checkpoint, CheckpointError> {
        let name = || CheckpointError::NoSuchScene(self.name.clone());
        self.running.as_ref().ok_or_else(name)?.save()
    }

    /// Runs a new scene that continues from a checkpoint. It has neither members nor owners nor a log.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] for a scene that exists or is damaged, one that the server does not admit, and as
    /// [`Checkpoint::scene`].
    pub fn restore(
        &mut self,
        now: Instant,
        checkpoint: &Checkpoint,
    ) -> Result<(), CheckpointError> {
        self.clients.at(now);
        if self.exists() || self.is_damaged() {
            return Err(CheckpointError::SceneExists(self.name.clone()));
        }
        let refused =
            |reason: &dyn std::fmt::Display| CheckpointError::NotAdmitted(reason.to_string());
        let (slot, mut load) = rights::admit_scene(&self.name, checkpoint.config(), &self.settings)
            .map_err(|denial| refused(&denial))?;
        let mut scene = checkpoint.scene_at_last_step(&self.settings.threads)?;
        // A later checkpoint of it replays what follows, and nothing of what led here.
        let mut rollback = Rollback::default();
        if self.settings.limits.restorations > 0 {
            rollback.begin_at(&mut scene, &Ownership::default());
        }
        checkpoint.apply_pending(&mut scene)?;
        let (bodies, most) = (scene.body_count(), self.settings.limits.bodies_per_scene);
        if bodies as u64 > most {
            let reason =
                format_args!("it has {bodies} bodies, and limits.bodies_per_scene is {most}");
            return Err(refused(&reason));
        }
        let steps = load::locomotion_steps(scene.locomotions());
        if !(0..bodies).all(|_| load.add_body()) || !load.set_locomotion(steps) {
            return Err(refused(
                &"its bodies take more than limits.scene_load or limits.server_load",
            ));
        }
        self.run_scene(scene, slot, load);
        if let Some(running) = &mut self.running {
            running.rollback = rollback;
            running.restore_shapes();
            running.restore_members(
                Sessions::default(),
                Ownership::default(),
                Vec::new(),
                &mut self.clients,
            );
        }
        self.note_empty();
        Ok(())
    }

    /// Gives the scene up to the server at an address, for which its log is complete on return. Its clients learn the address,
    /// and are closed.
    pub fn move_to(&mut self, now: Instant, to: &str) {
        self.clients.at(now);
        if let Some(running) = self.running.take() {
            let tick = running.scene.tick().value();
            running.leave_to_log(&mut self.clients);
            tracing::info!(scene = %self.name, tick, to = to, "the scene moves to another server");
        }
        self.clients.send_elsewhere(to);
    }

    /// Tells members what has become durable.
    pub fn report_durable(&mut self) {
        if let Some(running) = &mut self.running {
            running.report_durable(&mut self.clients);
        }
    }

    /// True if the store has a scene of this name that cannot be served.
    #[must_use]
    pub fn is_damaged(&self) -> bool {
        let store = self.settings.store.as_ref();
        store.is_some_and(|store| store.is_damaged(&self.name))
    }

    /// Reason why a scene that does not run cannot be joined.
    pub(super) fn absence(&self) -> Denial {
        if self.is_damaged() {
            Denial::SceneFaulted
        } else {
            Denial::NoSuchScene
        }
    }

    /// Creates the scene, which a feed steps if there is one.
    fn create(&mut self, config: SceneConfig, feed: Option<Arc<SharedFeed>>) -> Result<(), Denial> {
        if self.exists() {
            return Err(Denial::SceneExists);
        }
        let (slot, load) = rights::admit_scene(&self.name, &config, &self.settings)?;
        let settings = &self.settings;
        let engine: Result<Box<dyn Engine>, NoEngine> = match &feed {
            Some(feed) => Ok(Box::new(FedEngine::new(&config, Arc::clone(feed)))),
            None => settings.engines.make(&config, &settings.threads),
        };
        let engine = engine.map_err(|cause| {
            tracing::warn!(scene = %self.name, %cause, "a scene cannot begin");
            Denial::TooManyScenes
        })?;
        let scene = Scene::with_engine(config, engine).map_err(Denial::InvalidConfig)?;
        tracing::info!(scene = %self.name, "scene created");
        self.run_scene(scene, slot, load);
        if let Some(running) = &mut self.running {
            running.fed = feed.map(FedScene::new);
        }
        Ok(())
    }

    /// Runs a scene that is new or restored.
    fn run_scene(&mut self, scene: Scene, slot: SceneSlot, load: SceneLoad) {
        // One that is restored, perhaps by another server, has other names: members of edges may still get its old datagrams.
        let number = scene.tick().value().wrapping_add(self.begun.into());
        let names = StreamNames::of_scene(number);
        let settings = Arc::clone(&self.settings);
        let share = (slot, load);
        let running = RunningScene::new(&self.name, scene, names, settings, share);
        self.begun = self.begun.wrapping_add(1);
        self.running = Some(running);
    }
}

impl RunningScene {
    /// `names`: names of its streams. `slot`, `load`: its place, and its share of the server's time.
    pub(crate) fn new(
        name: &SceneName,
        mut scene: Scene,
        names: StreamNames,
        settings: Arc<SceneSettings>,
        (slot, load): (SceneSlot, SceneLoad),
    ) -> Self {
        scene.bound_crowding(settings.limits.crowding());
        let (target, config) = (scene.tick(), scene.config());
        let streams = Streams::new(config.publish_schedule, settings.threads.clone());
        let cells = Cells::of_scene(config, settings.cells, &settings.threads);
        let period = Span::from_nanos(config.integrator.rate.step_ns());
        let observer = settings.observers.begin(name, period);
        let hook = (settings.hooks.as_ref()).and_then(|hooks| hooks.of(name, config));
        Self {
            scene,
            hook,
            script: None,
            streams,
            cells,
            names,
            id_ranges: IdRanges::default(),
            ownership: Ownership::default(),
            authority_table: AuthorityTable::default(),
            scene_events: 0,
            unsent: Vec::new(),
            shape_events: BTreeMap::new(),
            target,
            waiting: VecDeque::new(),
            next_step: None,
            last_step: Instant::ZERO,
            pace: CommandPace::new(),
            times: Times::default(),
            faulted: false,
            rollback: Rollback::default(),
            restored_at: VecDeque::new(),
            late: false,
            owner: None,
            fed: None,
            settings,
            load,
            _slot: slot,
            empty_since: None,
            observer,
            sessions: Sessions::default(),
            durability: None,
        }
    }

    pub(crate) fn config(&self) -> &SceneConfig {
        self.scene.config()
    }

    /// Gives the scene to a client.
    pub(crate) const fn give_to(&mut self, owner: Peer) {
        self.owner = Some(owner);
    }

    /// The client that owns the scene, if one does.
    pub(crate) const fn owner(&self) -> Option<Peer> {
        self.owner
    }
}

impl Endpoint for SceneLoop {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.clients.at(now);
        // Any number will do that is seldom repeated.
        let seed = now.as_nanos() ^ peer.0.rotate_left(48);
        self.clients.open(peer, Grease::new(seed));
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.clients.receive(now, from, bytes.len());
        if let Some(session) = self.clients.session(from) {
            session.handle_control(bytes);
        }
        let client = self.clients.get(from);
        if client.is_some_and(|client| client.turn == Turn::AtOnce) {
            self.take_turn_at_once(now, from);
        }
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.clients.at(now);
        self.clients.note_taken(peer, bytes);
        if bytes > 0 {
            let is_sending = self.clients.has_snapshot_under_way(peer);
            if let Some(running) = self.running.as_mut().filter(|_| is_sending) {
                running.pace.note_snapshot();
            }
            self.answer_pending();
            self.retry(now);
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.clients.unread_bytes(from) < UNREAD_BYTES
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.clients.receive(now, from, bytes.len());
        let Ok(datagram) = Datagram::open(bytes) else {
            return;
        };
        if self.clients.member(from).is_none() {
            return;
        }
        let Some(running) = &mut self.running else {
            return;
        };
        let stream = datagram.head().stream;
        match datagram.head().kind {
            PacketKind::LossReport => {
                if let Ok(loss_report) = LossReport::decode(datagram.body()) {
                    running.handle_loss_report(now, from, stream, &loss_report, &mut self.clients);
                }
            }
            // All other packets come from the sender of a stream: here, of an upstream.
            _ => running.handle_upstream_datagram(from, &datagram, &mut self.clients),
        }
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        self.clients.at(now);
        if self.clients.close_if_stalled(peer) {
            return;
        }
        if self.clients.member(peer).is_none() {
            return;
        }
        if let Some(running) = &mut self.running {
            running.handle_link_report(now, peer, report, &mut self.clients);
        }
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        tracing::debug!(peer = peer.0, ?ending, "connection ended");
        self.clients.at(now);
        let reason = match ending {
            Ending::Closed(code) if code == CloseCode::DONE.0 => DisconnectReason::Left,
            Ending::Closed(_) | Ending::TimedOut | Ending::Broken => DisconnectReason::Disconnected,
        };
        self.handle_rest(now, peer, reason);
        self.answer_pending();
        self.leave(peer, reason);
        self.clients.forget(peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.clients.at(now);
        self.turns_left = load::TURNS_TIME;
        let queued = self.clients.take_in_turn(Turn::Queued);
        self.take_turns(now, &queued);
        if let Some(running) = &mut self.running {
            self.settings.heartbeat.beat();
            running.handle_timeout(now, &mut self.clients);
            if self.clients.next_snapshot().is_some_and(|at| at <= now) {
                running.answer_pending(&mut self.clients);
            }
        }
        self.retry(now);
        self.expire(now);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.clients.poll()
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let wake = |at, reason| Wake { at, reason };
        let running = self.running.as_ref();
        let step = running.and_then(RunningScene::next_step);
        let step = step.map(|at| wake(at, WakeReason::Tick));
        let has = |turn| self.clients.in_turn(turn).next().is_some();
        let input = has(Turn::Queued).then(|| wake(Instant::ZERO, WakeReason::Input));
        let retry = has(Turn::Blocked).then(|| wake(self.retry_at, WakeReason::Input));
        let snapshot = running.and_then(|_| self.clients.next_snapshot());
        let snapshot = snapshot.map(|at| wake(at, WakeReason::Snapshot));
        let expires = self.expires_at().map(|at| wake(at, WakeReason::Deadline));
        [step, input, retry, snapshot, expires]
            .into_iter()
            .flatten()
            .min_by_key(|wake| wake.at)
    }
}
