//! One scene with its members: applies commands, steps, publishes.
//!
//! Neither sockets nor threads: the loop of the scene feeds it requests and moments. Order of a tick: commands, step,
//! observe, send.

mod access;
mod acknowledgements;
mod authority;
mod command_log;
mod durability;
mod figures;
mod flow;
mod owner;
mod queries;
mod restoration;
mod scripted;
mod session;
mod subscriptions;
mod weight;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::limits::ADVANCE_TICKS_MAX;
use rhumb_protocol::message::{
    ClientMessage, Denial, Extensions, Joined, RemovalCause, SceneEvent, ServerMessage,
    StreamChoice,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{
    BodyDesc, Command, CommandError, SceneConfig, SceneName, Shape, ShapeId, Stepping,
};
use rhumb_protocol::stream::{Activity, StreamStart};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{BodyState, Tick};

use self::durability::Durability;
pub(crate) use self::session::DisconnectReason;
use self::weight::weight;
use crate::admission::SceneLoad;
use crate::authority_table::AuthorityTable;
use crate::body_placement;
use crate::hook::Hook;
use crate::id_ranges::IdRanges;
use crate::member::{Member, SnapshotRequest};
use crate::observer::{Incident, SceneObserver};
use crate::outbox::Outbox;
use crate::provided::SceneScript;
use crate::rights::{Ownership, Request};
use crate::rollback::Rollback;
use crate::scene::Scene;
use crate::sessions::Sessions;
use crate::settings::SceneSettings;
use crate::snapshot::append_snapshot;
use crate::stream_names::StreamNames;
use crate::streams::{Stream, Streams};
use crate::times::{Times, Timestamps};

/// One scene with its members.
pub(crate) struct SceneRunner {
    scene: Scene,
    hook: Option<Hook>,
    script: Option<SceneScript>,
    members: BTreeMap<Peer, Member>,
    streams: Streams,
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
    times: Times,
    faulted: bool,
    /// The way back if the engine fails.
    rollback: Rollback,
    /// When it was restored lately.
    restored_at: VecDeque<Instant>,
    /// True if the last step of the free-running scene was more than a step late.
    late: bool,
    /// True if a client of another protocol owns the scene: only that client steps and ends it.
    owned: bool,
    settings: Arc<SceneSettings>,
    load: SceneLoad,
    observer: Box<dyn SceneObserver>,
    sessions: Sessions,
    /// Its command log, if it survives the process.
    durability: Option<Durability>,
}

/// A free-running scene that is later than so many steps slows down instead of catching up.
const CATCH_UP_STEPS: u64 = 5;

impl SceneRunner {
    /// `names`: names of its streams. `load`: its share of the server's time.
    pub(crate) fn new(
        name: &SceneName,
        scene: Scene,
        names: StreamNames,
        settings: Arc<SceneSettings>,
        load: SceneLoad,
    ) -> Self {
        let (target, config) = (scene.tick(), scene.config());
        let streams = Streams::new(config.publish_schedule, settings.threads.clone());
        let period = Span::from_nanos(config.integrator.rate.step_ns());
        let observer = settings.observers.begin(name, period);
        let hook = (settings.hooks.as_ref()).and_then(|hooks| hooks.of(name, config));
        Self {
            scene,
            hook,
            script: None,
            members: BTreeMap::new(),
            streams,
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
            times: Times::default(),
            faulted: false,
            rollback: Rollback::default(),
            restored_at: VecDeque::new(),
            late: false,
            owned: false,
            settings,
            load,
            observer,
            sessions: Sessions::default(),
            durability: None,
        }
    }

    pub(crate) fn config(&self) -> &SceneConfig {
        self.scene.config()
    }

    /// True if a client of another protocol owns the scene.
    pub(crate) const fn is_owned(&self) -> bool {
        self.owned
    }

    pub(crate) fn members(&self) -> impl Iterator<Item = Peer> {
        self.members.keys().copied()
    }

    /// True if it has neither members, nor an owner, nor a log that keeps it.
    pub(crate) fn is_abandoned(&self) -> bool {
        self.members.is_empty() && !self.owned && !self.is_durable()
    }

    /// The time of the next step: at once in a scene that must advance, never in one without members.
    pub(crate) fn next_step(&self) -> Option<Instant> {
        if self.faulted {
            return None;
        }
        match self.config().stepping {
            Stepping::Lockstep => (self.scene.tick() < self.target).then_some(Instant::ZERO),
            Stepping::FreeRunning => self.next_step,
        }
    }

    /// A name for a new stream.
    fn new_stream(&mut self) -> StreamId {
        let (streams, authority_table) = (&self.streams, &self.authority_table);
        self.names
            .next(|name| streams.get(name).is_some() || authority_table.has(name))
    }

    fn begin_stream(&mut self, choice: StreamChoice) -> StreamId {
        let id = self.new_stream();
        let stream = self.streams.begin(Stream::new(
            choice,
            id,
            self.settings.largest_packet,
            &self.scene,
        ));
        for (id, parameters, track, motion) in body_placement::everything(&self.scene) {
            stream.place(id, &parameters, track, motion);
        }
        id
    }

    /// Sends the start of the stream, and every shape and body.
    fn send_snapshot(&mut self, peer: Peer, out: &mut Outbox) {
        let granted = match self.id_ranges.first(peer) {
            Some(range) => range,
            None => return,
        };
        if let Some(member) = self.members.get(&peer) {
            self.streams.begin_snapshot(member.stream(), peer);
        }
        let Some(stream) = self.stream_of(peer) else {
            return;
        };
        let start = StreamStart {
            stream: stream.id(),
            tolerance: stream.tolerance(),
            integrator: self.config().integrator,
            publish_interval: self.config().publish_schedule.publish_interval,
            largest_packet: stream.sender.largest_packet(),
            gravity: self.scene.gravity(),
            tick: stream.sender.tick(),
            next: stream.sender.next_number(),
            scene_events: self.scene_events,
        };
        let joined = Joined {
            choice: stream.choice,
            config: *self.config(),
            start,
            granted,
            extensions: Extensions::NONE,
        };
        let mut rest = Vec::new();
        append_snapshot(
            &self.scene,
            stream,
            self.authority_table.silences(),
            &mut rest,
        );
        out.send(peer, &ServerMessage::Joined(joined));
        let mut bytes = rest.len();
        for event in self.shape_events.values() {
            bytes += event.len();
            out.send_encoded(peer, event);
        }
        out.send_encoded(peer, &Bytes::from(rest));
        out.note_snapshot(peer, bytes);
    }

    fn stream_of(&self, peer: Peer) -> Option<&Stream> {
        let member = self.members.get(&peer)?;
        self.streams.get(member.stream())
    }

    /// A member's message shows that it has the scene.
    fn note_activity(&mut self, peer: Peer) {
        if let Some(member) = self.members.get_mut(&peer) {
            member.link.note_message();
        }
    }

    /// Acts on a command, an advance, or a request for authority, in the order of sending: a message that follows an
    /// advance waits for its steps.
    pub(crate) fn handle_ordered(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        out: &mut Outbox,
    ) {
        self.note_activity(peer);
        let steps_pending =
            self.config().stepping == Stepping::Lockstep && self.scene.tick() < self.target;
        if !steps_pending || self.faulted {
            return self.act_on(peer, message, out);
        }
        if let Some(member) = self.members.get_mut(&peer) {
            member.pending_bytes += weight(&message);
            self.waiting.push_back((peer, message));
        }
    }

    /// Acts on waiting messages, up to the next advance with pending steps.
    fn act_on_waiting(&mut self, out: &mut Outbox) {
        while self.faulted || self.scene.tick() >= self.target {
            let Some((peer, message)) = self.waiting.pop_front() else {
                break;
            };
            if let Some(member) = self.members.get_mut(&peer) {
                member.pending_bytes = member.pending_bytes.saturating_sub(weight(&message));
            }
            self.act_on(peer, message, out);
        }
        self.answer_pending(out);
    }

    fn act_on(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        out: &mut Outbox,
    ) {
        let Some(member) = self.members.get_mut(&peer) else {
            return;
        };
        let command = match message {
            Ok(ClientMessage::Command(command)) => Ok(command),
            Err(error) => Err(error),
            Ok(ClientMessage::Advance { to }) => {
                let allowed = self.check(peer, Request::Advance);
                let denial = match allowed {
                    Ok(()) => self.check_advance(to),
                    Err(_) => Some(Denial::AdvanceNotAllowed),
                };
                match denial {
                    Some(denial) => out.send(peer, &ServerMessage::Denied(denial)),
                    None => self.target = self.target.max(to),
                }
                return;
            }
            Ok(ClientMessage::TakeAuthority(request)) => {
                return self.grant_authority(peer, &request, out);
            }
            Ok(ClientMessage::Upstream(packet)) => {
                return self.handle_upstream_message(peer, &packet, out);
            }
            Ok(ClientMessage::Query(queries)) => {
                return self.answer_queries(peer, &queries, out);
            }
            // Other messages do not depend on their place among the commands.
            Ok(_) => return,
        };
        let (number, session) = (member.number_command(), member.session);
        member.charge_command(out.now());
        if let Ok(command) = &command {
            self.observer.command(peer, number, command);
        }
        let unsent = self.unsent.len();
        let applied = command.and_then(|command| self.apply_of_member(peer, &command));
        if applied.is_ok() {
            self.attribute(peer, number);
        }
        let refused = applied.err();
        let refused = refused.map(|error| self.restore_if_failed(out.now(), error));
        self.observer.commanded(refused.as_ref());
        self.note_command(session, refused);
        if let Some(error) = refused {
            out.send(peer, &ServerMessage::Refused { number, error });
        }
        let added = self.unsent.len().saturating_sub(unsent);
        if let Some(member) = self.members.get_mut(&peer) {
            member.added_bytes += added;
        }
    }

    fn check_advance(&self, to: Tick) -> Option<Denial> {
        let too_far = to.value() > self.scene.tick().value() + ADVANCE_TICKS_MAX;
        match self.config().stepping {
            Stepping::FreeRunning => Some(Denial::NotLockstep),
            Stepping::Lockstep if self.owned => Some(Denial::Owned),
            Stepping::Lockstep if self.faulted => Some(Denial::SceneFaulted),
            Stepping::Lockstep if too_far => Some(Denial::TooFarAhead),
            Stepping::Lockstep => None,
        }
    }

    fn apply(&mut self, peer: Peer, command: &Command) -> Result<(), CommandError> {
        if self.faulted {
            return Err(CommandError::SceneFaulted);
        }
        if let Command::AddBody { desc, .. } = command
            && !self.id_ranges.allows(peer, desc.id)
        {
            return Err(CommandError::NotGranted(desc.id));
        }
        self.check_not_under_authority(command)?;
        self.apply_and_announce(command)
    }

    /// Applies a command, and records what it changed for the streams and the members.
    fn apply_and_announce(&mut self, command: &Command) -> Result<(), CommandError> {
        self.copy_if_due();
        self.apply_within_load(command)?;
        let tick = self.scene.tick();
        match *command {
            Command::AddShape { id, ref shape } => self.announce_shape(id, shape.clone()),
            Command::RemoveShape { id } => self.forget_shape(id),
            Command::AddBody { desc, motion } => self.place(desc, motion, Activity::Awake),
            Command::ChangeBody { desc } => {
                if let Some(there) = self.scene.observation_at_tick(desc.id) {
                    self.place(desc, there.motion, there.activity);
                }
            }
            Command::RemoveBody { id } => {
                self.streams.remove(id);
                self.authority_table.remove(id);
                self.forget_body(id);
                let cause = RemovalCause::Command;
                self.record_event(SceneEvent::BodyRemoved { id, cause });
            }
            Command::AddJoint { id, ref joint } | Command::ChangeJoint { id, ref joint } => {
                self.record_event(SceneEvent::JointAdded { id, joint: **joint });
            }
            Command::RemoveJoint { id } => self.record_event(SceneEvent::JointRemoved { id }),
            Command::SetGravity { gravity } => {
                self.streams.change_gravity(tick, gravity);
                self.record_event(SceneEvent::GravityChanged {
                    since: tick,
                    gravity,
                });
            }
            _ => {}
        }
        Ok(())
    }

    /// Records that there is a shape, also for later members.
    fn announce_shape(&mut self, id: ShapeId, shape: Shape) {
        let from = self.unsent.len();
        self.record_event(SceneEvent::ShapeAdded { id, shape });
        let event = Bytes::copy_from_slice(&self.unsent[from..]);
        self.shape_events.insert(id, event);
    }

    /// Records that a shape is gone.
    fn forget_shape(&mut self, id: ShapeId) {
        self.shape_events.remove(&id);
        self.record_event(SceneEvent::ShapeRemoved { id });
    }

    /// Places a new or changed body in every stream: both ends predict it by its description from the newest tick on.
    fn place(&mut self, desc: BodyDesc, motion: BodyState, activity: Activity) {
        let (tick, tumbles) = (self.scene.tick(), self.scene.inertia(desc.id).is_some());
        let track = body_placement::first_track(tick, (motion, activity), &desc, tumbles);
        if let Some(parameters) = body_placement::parameters(&self.scene, desc.id) {
            self.streams.place(desc.id, &parameters, track, motion);
        }
        self.record_event(body_placement::scene_event(&self.scene, desc, track, None));
    }

    fn record_event(&mut self, scene_event: SceneEvent) {
        self.scene_events += 1;
        self.observer.scene_event(&scene_event);
        ServerMessage::SceneEvent(scene_event).encode(&mut self.unsent);
    }

    /// Sends new scene events to every member, encoded once.
    fn send_scene_events(&mut self, out: &mut Outbox) {
        if self.unsent.is_empty() {
            return;
        }
        let messages = Bytes::from(std::mem::take(&mut self.unsent));
        for peer in self.members.keys() {
            out.send_encoded(*peer, &messages);
        }
    }

    /// Answers the input of one read after all of it was handled.
    pub(crate) fn answer_pending(&mut self, out: &mut Outbox) {
        self.send_scene_events(out);
        self.commit();
        let pending_snapshots: Vec<(Peer, SnapshotRequest)> = self
            .members
            .iter_mut()
            .filter(|(peer, _)| out.may_snapshot(**peer))
            .filter_map(|(peer, member)| Some((*peer, member.snapshot_request.take()?)))
            .collect();
        for (peer, snapshot_request) in pending_snapshots {
            match self.begin_snapshot_change(peer, snapshot_request) {
                Ok(()) => self.send_snapshot(peer, out),
                Err(denial) => out.send(peer, &ServerMessage::Denied(denial)),
            }
        }
        let tick = self.scene.tick();
        for (peer, member) in &mut self.members {
            if let Some(through) = member.unanswered.take() {
                out.send(*peer, &ServerMessage::Applied { through, tick });
            }
        }
    }

    /// Steps if a step is due.
    pub(crate) fn handle_timeout(&mut self, now: Instant, out: &mut Outbox) {
        if self.next_step().is_none_or(|due| due > now) {
            return;
        }
        if let Some(due) = self.next_step {
            let step = self.step();
            let late_by = now.since(due).as_nanos();
            self.late = late_by > step.as_nanos();
            if self.late {
                self.observer.incident(Incident::Late);
            }
            let kept = late_by <= step.as_nanos() * CATCH_UP_STEPS;
            self.next_step = Some(if kept { due + step } else { now + step });
            if !kept {
                self.observer.incident(Incident::Slowed);
            }
        }
        self.last_step = now;
        self.tick(out);
        if self.config().stepping == Stepping::FreeRunning {
            let send = |peer, question| out.datagram(peer, question);
            self.authority_table
                .poll_requests(now, self.scene.tick(), send);
        }
        self.act_on_waiting(out);
    }

    /// The moment by the clock that measures.
    pub(crate) fn clock_now(&self) -> Instant {
        (self.settings.clock)()
    }

    fn step(&self) -> Span {
        Span::from_nanos(self.config().integrator.rate.step_ns())
    }

    /// One tick: step, predict, publish.
    fn tick(&mut self, out: &mut Outbox) {
        let begun = self.clock_now();
        self.copy_if_due();
        self.observer.step_began(begun, self.scene.tick());
        for scene_event in self.authority_table.set_targets(&mut self.scene) {
            self.record_event(scene_event);
        }
        self.run_script();
        let hook = self.hook.as_mut();
        let refused = hook.map(|hook| hook.act(&mut self.scene));
        let Some(stepped) = self.step_or_restore(out) else {
            return;
        };
        let after_step = self.clock_now();
        self.rollback.note_step(after_step.since(begun));
        self.snapshot_if_due(after_step.since(begun));
        for error in refused.into_iter().flatten() {
            tracing::warn!(%error, "the scene continues without the command");
        }
        for (id, cause) in stepped.removed {
            self.note_removal(cause);
            self.streams.remove(id);
            self.authority_table.remove(id);
            self.forget_body(id);
            self.record_event(SceneEvent::BodyRemoved { id, cause });
        }
        for id in stepped.broken {
            self.ownership.remove_joint(id);
            self.record_event(SceneEvent::JointRemoved { id });
        }
        self.streams
            .observe(self.scene.tick(), self.scene.observations());
        let observed = self.clock_now();
        self.streams.publish(self.scene_events);
        self.commit();
        self.send_scene_events(out);
        self.send_step_events(stepped.happened, out);
        for (peer, member) in &self.members {
            for stream in member.streams() {
                for packet in self.streams.packets(stream, *peer) {
                    out.datagram(*peer, packet.clone());
                }
            }
        }
        self.note_times(Timestamps {
            begun,
            stepped: after_step,
            observed,
            published: self.clock_now(),
        });
    }

    pub(crate) fn pong(&mut self, now: Instant, peer: Peer, sent: Instant, out: &mut Outbox) {
        self.note_activity(peer);
        let pong = ServerMessage::Pong {
            sent,
            tick: self.scene.tick(),
            since_tick_ns: now.since(self.last_step).as_nanos(),
        };
        out.send(peer, &pong);
    }

    /// Informs the members that the scene has ended.
    pub(crate) fn end(mut self, out: &mut Outbox) {
        self.delete_log(out);
        for peer in self.members.keys() {
            self.authority_table.end(*peer);
            out.send(*peer, &ServerMessage::Deleted);
        }
    }
}
