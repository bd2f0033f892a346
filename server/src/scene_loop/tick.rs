//! The ticks of a scene, and the messages that keep their places between them.
//!
//! Order of a tick: commands, step, observe, send.

use bytes::Bytes;
use rhumb_protocol::limits::PENDING_COMMANDS_MAX;
use rhumb_protocol::message::{ClientMessage, Denial, RemovalCause, SceneEvent, ServerMessage};
use rhumb_protocol::scene::{Command, CommandError, Locomotion, Stepping};
use rhumb_protocol::{Instant, Peer, Span};

use super::RunningScene;
use crate::authority_table;
use crate::clients::Clients;
use crate::observer::{Incident, Timestamps};
use crate::record::TickMetrics;
use crate::settings::SceneScript;

/// A free-running scene that is later than so many steps slows down instead of catching up.
const CATCH_UP_STEPS: u64 = 5;

impl RunningScene {
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

    /// Acts on a command, an advance, or a request for authority, in the order of sending: a message that follows an
    /// advance waits for its steps.
    pub(crate) fn handle_ordered(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        clients: &mut Clients,
    ) {
        note_activity(peer, clients);
        let steps_pending =
            self.config().stepping == Stepping::Lockstep && self.scene.tick() < self.target;
        if !steps_pending || self.faulted {
            return self.act_on(peer, message, clients);
        }
        if let Some(member) = clients.member_mut(peer) {
            member.pending_bytes += weight(&message);
            self.waiting.push_back((peer, message));
        }
    }

    /// Acts on waiting messages, up to the next advance with pending steps.
    fn act_on_waiting(&mut self, clients: &mut Clients) {
        while self.faulted || self.scene.tick() >= self.target {
            let Some((peer, message)) = self.waiting.pop_front() else {
                break;
            };
            if let Some(member) = clients.member_mut(peer) {
                member.pending_bytes = member.pending_bytes.saturating_sub(weight(&message));
            }
            self.act_on(peer, message, clients);
        }
        self.answer_pending(clients);
    }

    fn act_on(
        &mut self,
        peer: Peer,
        message: Result<ClientMessage, CommandError>,
        clients: &mut Clients,
    ) {
        if clients.member(peer).is_none() {
            return;
        }
        let command = match message {
            Ok(ClientMessage::Command(command)) => Ok(command),
            Err(error) => Err(error),
            Ok(ClientMessage::Advance { to }) => {
                let rights = self.rights_of(peer, clients).ok_or(Denial::NotAllowed);
                match rights.and_then(|rights| rights.advance(to)) {
                    Ok(()) => self.target = self.target.max(to),
                    Err(denial) => clients.send(peer, &ServerMessage::Denied(denial)),
                }
                return;
            }
            Ok(ClientMessage::TakeAuthority(request)) => {
                return self.grant_authority(peer, &request, clients);
            }
            Ok(ClientMessage::Upstream(packet)) => {
                return self.handle_upstream_message(peer, &packet, clients);
            }
            Ok(ClientMessage::Query(queries)) => {
                return self.answer_queries(peer, &queries, clients);
            }
            // Other messages do not depend on their place among the commands.
            Ok(_) => return,
        };
        let Some((number, session)) = clients.begin_command(peer) else {
            return;
        };
        if let Ok(command) = &command {
            self.observer.command(peer, number, command);
        }
        let unsent = self.unsent.len();
        let applied =
            command.and_then(|command| self.apply_of_member((peer, number), &command, clients));
        let refused = applied.err();
        let refused = refused.map(|error| self.restore_if_failed(error, clients));
        self.observer.commanded(refused.as_ref());
        self.note_command(session, refused);
        if let Some(error) = refused {
            clients.send(peer, &ServerMessage::Refused { number, error });
        }
        let added = self.unsent.len().saturating_sub(unsent);
        if let Some(member) = clients.member_mut(peer) {
            member.added_bytes += added;
        }
    }

    pub(super) fn record_event(&mut self, scene_event: SceneEvent) {
        self.scene_events += 1;
        self.observer.scene_event(&scene_event);
        ServerMessage::SceneEvent(scene_event).encode(&mut self.unsent);
    }

    /// Sends new scene events to every member, encoded once.
    pub(super) fn send_scene_events(&mut self, clients: &mut Clients) {
        if self.unsent.is_empty() {
            return;
        }
        let messages = Bytes::from(std::mem::take(&mut self.unsent));
        let (members, out) = clients.members_mut();
        for (_, control) in members {
            control.send_encoded(&messages, out);
        }
    }

    /// Answers the input of one read after all of it was handled.
    pub(crate) fn answer_pending(&mut self, clients: &mut Clients) {
        self.send_scene_events(clients);
        self.commit(clients);
        self.shorten_log(clients);
        for (peer, snapshot_request) in clients.take_snapshot_requests() {
            match self.begin_snapshot_change(peer, snapshot_request, clients) {
                Ok(()) => self.send_snapshot(peer, clients),
                Err(denial) => clients.send(peer, &ServerMessage::Denied(denial)),
            }
        }
        let tick = self.scene.tick();
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            if let Some(through) = member.unanswered.take() {
                control.send(&ServerMessage::Applied { through, tick }, out);
            }
        }
    }

    /// Steps if a step is due.
    pub(crate) fn handle_timeout(&mut self, now: Instant, clients: &mut Clients) {
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
        self.tick(clients);
        if self.config().stepping == Stepping::FreeRunning {
            authority_table::send_reports(now, self.scene.tick(), clients);
        }
        self.act_on_waiting(clients);
    }

    /// The moment by the clock that measures.
    pub(crate) fn clock_now(&self) -> Instant {
        (self.settings.clock)()
    }

    pub(super) fn step(&self) -> Span {
        Span::from_nanos(self.config().integrator.rate.step_ns())
    }

    /// One tick: step, predict, publish.
    fn tick(&mut self, clients: &mut Clients) {
        let begun = self.clock_now();
        self.copy_if_due();
        self.observer.step_began(begun, self.scene.tick());
        let table = &mut self.authority_table;
        for scene_event in table.set_targets(&mut self.scene, clients) {
            self.record_event(scene_event);
        }
        self.run_script(clients);
        let hook = self.hook.as_mut();
        let refused = hook.map(|hook| hook.act(&mut self.scene));
        let Some(stepped) = self.step_or_restore(clients) else {
            return;
        };
        let after_step = self.clock_now();
        self.rollback.note_step(after_step.since(begun));
        self.snapshot_if_due(after_step.since(begun), clients);
        for error in refused.into_iter().flatten() {
            tracing::warn!(%error, "the scene continues without the command");
        }
        for (id, cause) in stepped.removed {
            self.note_removal(cause);
            self.remove_body(id, cause, clients);
        }
        for id in stepped.broken {
            self.ownership.remove_joint(id);
            self.record_event(SceneEvent::JointRemoved { id });
        }
        self.streams
            .observe(self.scene.tick(), self.scene.observations());
        let observed = self.clock_now();
        self.streams.publish(self.scene_events);
        self.commit(clients);
        self.send_scene_events(clients);
        self.send_step_events(stepped.happened, clients);
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            for stream in member.streams() {
                for packet in self.streams.packets(stream, control.peer()) {
                    control.send_datagram(packet.clone(), out);
                }
            }
        }
        let timestamps = Timestamps {
            begun,
            stepped: after_step,
            observed,
            published: self.clock_now(),
        };
        self.note_times(timestamps, clients.member_count());
    }

    pub(crate) fn pong(&mut self, now: Instant, peer: Peer, sent: Instant, clients: &mut Clients) {
        note_activity(peer, clients);
        let pong = ServerMessage::Pong {
            sent,
            tick: self.scene.tick(),
            since_tick_ns: now.since(self.last_step).as_nanos(),
        };
        clients.send(peer, &pong);
    }

    /// Informs the members that the scene has ended.
    pub(crate) fn end(mut self, clients: &mut Clients) {
        self.delete_log(clients);
        for (peer, member) in clients.take_members() {
            if let Some(group) = member.authority {
                group.log_end(peer);
            }
            clients.send(peer, &ServerMessage::Deleted);
        }
    }
}

/// A member's message shows that it has the scene.
fn note_activity(peer: Peer, clients: &mut Clients) {
    if let Some(member) = clients.member_mut(peer) {
        member.link.note_message();
    }
}

/// Weight of a waiting message beside its shape or packet.
const MESSAGE_WEIGHT: usize = 64;

/// Weight of a waiting message: about its bytes in memory.
fn weight(message: &Result<ClientMessage, CommandError>) -> usize {
    MESSAGE_WEIGHT
        + match message {
            Ok(ClientMessage::Command(Command::AddShape { shape, .. })) => shape.bytes(),
            Ok(ClientMessage::Command(Command::SetLocomotion { locomotion, .. })) => {
                size_of::<Locomotion>() + wheels_bytes(locomotion)
            }
            Ok(ClientMessage::Command(Command::SetWheels { inputs, .. })) => size_of_val(&**inputs),
            Ok(ClientMessage::Upstream(packet)) => packet.len(),
            Ok(ClientMessage::Query(queries)) => size_of_val(&**queries),
            _ => 0,
        }
}

fn wheels_bytes(locomotion: &Locomotion) -> usize {
    match locomotion {
        Locomotion::Vehicle(vehicle) => size_of_val(&*vehicle.wheels),
        Locomotion::None | Locomotion::Character(_) => 0,
    }
}

/// Weight of the messages of one member that may wait for the steps of an advance: [`PENDING_COMMANDS_MAX`] short ones.
const PENDING_BYTES_MAX: usize = PENDING_COMMANDS_MAX * MESSAGE_WEIGHT;
/// A member for which more than this waits is behind.
const MEMBER_BEHIND_BYTES: usize = 2 << 20;

impl RunningScene {
    /// True if a member's next message must stay unread: as much as may waits for the steps of an advance, its commands
    /// exceed its quota, or what it added to the scene still waits for slower members.
    pub(crate) fn holds_back(now: Instant, peer: Peer, clients: &mut Clients) -> bool {
        let Some(member) = clients.member_mut(peer) else {
            return false;
        };
        if member.pending_bytes >= PENDING_BYTES_MAX {
            return true;
        }
        if member.is_over_rate(now) {
            return true;
        }
        if !member.adds_too_much(now) {
            return false;
        }
        clients.is_any_behind(MEMBER_BEHIND_BYTES)
    }

    /// Bytes of scene events that the members have not got yet.
    pub(crate) const fn unsent_bytes(&self) -> usize {
        self.unsent.len()
    }
}

impl RunningScene {
    /// Attaches a script, which commands the scene before each step, and runs it once. Members get ids after
    /// those of its bodies.
    pub(crate) fn follow_script(&mut self, script: SceneScript, clients: &mut Clients) {
        self.script = Some(script);
        self.run_script(clients);
        let indices = self.scene.bodies().map(|body| body.id.index() + 1);
        let end = indices.max().unwrap_or(0);
        self.id_ranges.begin_after(end);
    }

    /// Applies the script's commands before the next step.
    fn run_script(&mut self, clients: &mut Clients) {
        let Some(mut script) = self.script.take() else {
            return;
        };
        if !self.faulted && self.scene.is_sound() {
            for command in script.commands(&self.scene) {
                // A script may add thousands of bodies at once.
                self.settings.heartbeat.beat();
                if let Err(error) = self.apply_and_announce(&command, clients) {
                    tracing::warn!(%error, "a command of the scene's script is refused");
                }
            }
        }
        self.script = Some(script);
    }
}

impl RunningScene {
    /// Adds the times of a tick to the scene's metrics.
    fn note_times(&mut self, timestamps: Timestamps, members: usize) {
        self.times.add(timestamps);
        let metrics = TickMetrics {
            tick: self.scene.tick(),
            members,
            bodies: self.scene.body_count(),
            awake: self.scene.awake_count(),
            waiting: self.streams.waiting(),
            load: self.load.reserved(),
            step: timestamps.stepped.since(timestamps.begun),
            publish: timestamps.published.since(timestamps.stepped),
        };
        let mut packets = self.streams.all_packets();
        let observer = &mut self.observer;
        observer.stepped(&metrics, &self.scene, &mut packets);
    }

    /// A body whose state was not finite is a fault of the engine.
    fn note_removal(&mut self, cause: RemovalCause) {
        if cause == RemovalCause::NotFinite {
            self.observer.incident(Incident::NotFinite);
        }
    }
}
