//! Survival of a scene: of its process by the log, of its engine by copies.
//!
//! It hands its record to its command log, reports what is durable, and never waits for the disk. Snapshots are due by the
//! time that steps have taken, so that their replay takes no longer.
//!
//! A scene whose engine failed continues, or stands still with a reason. The restored scene is compared with what the
//! members know, and they learn the difference by ordinary scene events: streams, tracks and sessions continue.

use std::collections::BTreeSet;

use rhumb_protocol::message::{FaultCause, RemovalCause, SceneEvent, ServerMessage};
use rhumb_protocol::scene::{CommandError, JointId, ShapeId};
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::BodyId;

use super::RunningScene;
use crate::checkpoint::{Checkpoint, CheckpointError, FailedIn, Restoration};
use crate::clients::Clients;
use crate::engine::EngineFault;
use crate::event_monitor::EventKey;
use crate::hook::Incident;
use crate::member::SessionCommands;
use crate::record::{Author, LogEntry, SessionNumber};
use crate::scene::{Scene, SceneFault, Stepped};
use crate::sessions::{CommandLog, Durability, Frozen};

impl RunningScene {
    /// Starts the command log. `replayed`: time that its restoration took.
    pub(crate) fn keep_log(&mut self, log: Box<dyn CommandLog>, replayed: Span) {
        self.scene.record_mut().begin_log();
        let tick = self.scene.tick();
        self.durability = Some(Durability::new(log, replayed, tick));
    }

    /// True if the scene survives the process.
    pub(crate) const fn is_durable(&self) -> bool {
        self.durability.is_some()
    }

    /// Notes what concerns a session, here and for the log.
    pub(super) fn note_session(&mut self, entry: LogEntry) {
        self.sessions.replay(&entry);
        let tick = self.scene.tick();
        self.scene.record_mut().note(tick, entry);
    }

    /// Notes that a command of a member is done.
    pub(super) fn note_command(
        &mut self,
        session: Option<SessionNumber>,
        refused: Option<CommandError>,
    ) {
        if let Some(session) = session {
            self.note_session(LogEntry::Counted(session, refused));
        }
    }

    /// Hands everything since the last call to the log.
    pub(super) fn commit(&mut self, clients: &mut Clients) {
        // The scene comes back as it was before the work at which it was given up.
        if self.settings.heartbeat.is_abandoned() {
            return;
        }
        let Some(durability) = &mut self.durability else {
            return;
        };
        let Some(batch) = self.scene.record_mut().take_batch() else {
            return;
        };
        if durability.is_beyond(2 * self.settings.limits.scene_log_bytes()) {
            let mib = 2 * self.settings.limits.scene_log_mib;
            tracing::error!(
                mib,
                "a log without a snapshot is too long: commands are not durable until the next one"
            );
            durability.log.give_up();
        }
        let number = durability.log.append(batch);
        let tick = self.scene.tick();
        for (member, _) in clients.members_mut().0 {
            member.note_logged(number, tick);
        }
    }

    /// Hands a snapshot to the log if one is due by the time of steps, of which this is the newest one, or by bytes.
    pub(super) fn snapshot_if_due(&mut self, stepped: Span, clients: &mut Clients) {
        let tick = self.scene.tick();
        let Some(durability) = &mut self.durability else {
            return;
        };
        let taken = durability.stepped.as_nanos() + stepped.as_nanos();
        durability.stepped = Span::from_nanos(taken);
        if durability.is_snapshot_due(tick) {
            self.snapshot(clients);
        }
    }

    /// Hands a snapshot to the log if that is long. A scene that is not stepped has no other occasion.
    pub(super) fn shorten_log(&mut self, clients: &mut Clients) {
        if (self.durability.as_ref()).is_some_and(Durability::is_long) {
            self.snapshot(clients);
        }
    }

    /// True if the log takes no more commands before a step, which lets a snapshot shorten it.
    pub(super) fn is_log_full(&self) -> bool {
        let most = self.settings.limits.scene_log_bytes();
        (self.durability.as_ref()).is_some_and(|durability| durability.is_beyond(most))
    }

    /// Hands a snapshot to the log, unless something has changed since the last step that it would lack.
    fn snapshot(&mut self, clients: &mut Clients) {
        if self.settings.heartbeat.is_abandoned() {
            return;
        }
        let tick = self.scene.tick();
        let Some(scene) = self.scene.freeze() else {
            return;
        };
        self.commit(clients);
        let frozen = Frozen {
            tick,
            digest: self.scene.digest(),
            sessions: self.sessions.clone(),
            ownership: self.ownership.clone(),
            scene,
        };
        if let Some(durability) = &mut self.durability {
            durability.stepped = Span::ZERO;
            durability.snapshot_tick = tick;
            durability.log.snapshot(frozen);
        }
    }

    /// Keeps the answers to a member back until its session and its indices are durable: they then survive a failure of
    /// the server. A broken log keeps no answers back.
    pub(super) fn answer_durably(&mut self, peer: Peer, clients: &mut Clients) {
        self.commit(clients);
        if let Some(durability) = &self.durability
            && !durability.log.is_broken()
        {
            clients.keep_back(peer, durability.log.appended());
        }
    }

    /// Tells a member when the commands of the session that it takes up are durable, though it sends no other ones.
    pub(super) fn acknowledge_resumed(&mut self, peer: Peer, clients: &mut Clients) {
        self.commit(clients);
        let count = (self.session_of(peer, clients)).map_or(0, |session| session.commands);
        let tick = self.scene.tick();
        if count > 0
            && let Some(durability) = &self.durability
            && let Some(member) = clients.member_mut(peer)
        {
            let newest = durability.log.appended();
            member.awaited.push(newest, SessionCommands { count, tick });
        }
    }

    /// Tells members which of their commands are durable, and sends the answers that waited for the log.
    pub(crate) fn report_durable(&mut self, clients: &mut Clients) {
        let Some(durability) = &self.durability else {
            return;
        };
        let durable = durability.log.durable();
        let is_broken = durability.log.is_broken();
        clients.release(|batch| batch <= durable || is_broken);
        let (members, out) = clients.members_mut();
        for (member, control) in members {
            while let Some(SessionCommands { count, tick }) = member.awaited.pop_durable(durable) {
                let commands = count;
                control.send(&ServerMessage::Durable { commands, tick }, out);
            }
        }
    }

    /// Ends the scene here, with everything in its log, and with its memberships.
    pub(super) fn leave_to_log(mut self, clients: &mut Clients) {
        self.commit(clients);
        for (peer, member) in clients.take_members() {
            self.observer.left(peer);
            if let Some(group) = member.authority {
                group.log_end(peer);
            }
        }
        // The log waits until all is written; answers that waited for it may go then.
        drop(self);
        clients.release(|_| true);
    }

    /// Removes the files of a scene that has ended.
    pub(super) fn delete_log(&mut self, clients: &mut Clients) {
        if let Some(durability) = self.durability.take() {
            clients.release(|_| true);
            durability.log.delete();
        }
    }
}

/// The time in which a scene may be restored [`crate::Limits::restorations`] times.
const PERIOD: Span = Span::from_millis(600_000);

impl RunningScene {
    /// Copies the scene, if that is due, before it changes.
    pub(super) fn copy_if_due(&mut self) {
        if self.settings.limits.restorations > 0 {
            self.rollback.copy_if_due(&mut self.scene, &self.ownership);
        }
    }

    /// The state of the scene.
    pub(crate) fn save(&self) -> Result<Checkpoint, CheckpointError> {
        if self.fed.is_some() {
            return Err(CheckpointError::Fed);
        }
        Checkpoint::of(&self.scene, self.rollback.way_to(&self.scene))
    }

    /// Steps; a scene whose engine fails is restored first. `None` if it stands still.
    pub(super) fn step_or_restore(&mut self, clients: &mut Clients) -> Option<Stepped> {
        let fault = match self.scene.step() {
            Ok(stepped) => return Some(stepped),
            Err(fault) => fault,
        };
        tracing::error!(%fault, "a step failed");
        let failed_in = match fault {
            SceneFault::Engine(EngineFault::Panicked) => FailedIn::Step,
            SceneFault::Engine(EngineFault::Crowded) | SceneFault::TooCrowded { .. } => {
                FailedIn::Crowd
            }
        };
        let restored = self.restore(failed_in, clients);
        let stepped = restored.and_then(|left_out| {
            let error = match failed_in {
                FailedIn::Crowd => CommandError::TooCrowded,
                FailedIn::Step | FailedIn::Command => CommandError::EngineFailed,
            };
            for author in left_out {
                Self::refuse_late(&author, error, clients);
            }
            self.scene.step().map_err(|_| FaultCause::FailedAgain)
        });
        stepped.map_err(|cause| self.fault(cause, clients)).ok()
    }

    /// The error of a command that was refused: one on which the engine failed is left out, and the scene continues.
    pub(super) fn restore_if_failed(
        &mut self,
        error: CommandError,
        clients: &mut Clients,
    ) -> CommandError {
        if self.faulted || self.scene.is_sound() {
            return error;
        }
        match self.restore(FailedIn::Command, clients) {
            Ok(_) => CommandError::EngineFailed,
            // The next step notes the fault.
            Err(_) => error,
        }
    }

    /// Puts an earlier state in the place of the failed scene; returns the authors of the commands that it lacks.
    fn restore(
        &mut self,
        failed_in: FailedIn,
        clients: &mut Clients,
    ) -> Result<Vec<Author>, FaultCause> {
        let now = clients.now();
        if failed_in != FailedIn::Crowd && !self.scene.is_sound() {
            self.observer.incident(Incident::EnginePanicked);
        }
        while let Some(first) = self.restored_at.front()
            && now.since(*first) >= PERIOD
        {
            self.restored_at.pop_front();
        }
        if self.scene.record().bytes_since_base().is_none() {
            return Err(FaultCause::NoWayBack);
        }
        if self.restored_at.len() as u64 >= self.settings.limits.restorations {
            return Err(FaultCause::TooOften);
        }
        let heartbeat = self.settings.heartbeat.clone();
        let restoration = self
            .rollback
            .restore(&self.scene, failed_in, &mut || heartbeat.beat())
            .ok_or(FaultCause::FailedAgain)?;
        self.restored_at.push_back(now);
        self.observer.incident(Incident::Restored);
        tracing::error!(
            tick = self.scene.tick().value(),
            ?failed_in,
            left_out = restoration.left_out.len(),
            "the scene continues without the commands on which it failed"
        );
        Ok(self.adopt(restoration, clients))
    }

    /// Continues with a restored scene, and informs the members.
    fn adopt(&mut self, restoration: Restoration, clients: &mut Clients) -> Vec<Author> {
        let Restoration {
            scene,
            ownership,
            left_out,
            differs,
        } = restoration;
        if let Some(durability) = &mut self.durability {
            // The log has commands that are left out: the log begins anew with the next snapshot.
            durability.log.give_up();
        }
        self.commit(clients);
        let before = std::mem::replace(&mut self.scene, scene);
        self.ownership = ownership;
        if self.is_durable() {
            self.scene.record_mut().begin_log();
        }
        if !left_out.is_empty() {
            self.tell_difference(&before, differs, clients);
        }
        self.reserve_locomotion();
        let tick = self.scene.tick();
        self.record_event(SceneEvent::SceneRestored { tick });
        for (member, _) in clients.members_mut().0 {
            member.standing_after = Some(EventKey::FIRST);
        }
        // The failed engine's world may be large, or broken.
        drop(before);
        left_out.into_iter().flatten().collect()
    }

    /// Records the scene events that lead from one state of the scene to the present one.
    fn tell_difference(&mut self, before: &Scene, differs: bool, clients: &mut Clients) {
        let removed = self.remove_differing(before, clients);
        let reshaped = self.differing_shapes(before);
        for id in &reshaped {
            if before.shape(*id).is_some() {
                self.forget_shape(*id);
            }
        }
        let added: Vec<_> = (reshaped.iter())
            .filter_map(|id| Some((*id, self.scene.shape(*id)?.clone())))
            .collect();
        for (id, shape) in added {
            self.announce_shape(id, shape);
        }
        if before.gravity() != self.scene.gravity() {
            let (since, gravity) = (self.scene.tick(), self.scene.gravity());
            self.streams.change_gravity(since, gravity);
            self.record_event(SceneEvent::GravityChanged { since, gravity });
        }
        let placed: Vec<_> = (self.scene.bodies().copied())
            .filter(|desc| {
                let same = before.body(desc.id) == Some(desc) && !removed.contains(&desc.id);
                differs || !same
            })
            .collect();
        for desc in placed {
            if let Some(there) = self.scene.observation_at_tick(desc.id) {
                if before.body(desc.id).is_none() {
                    self.load.add_body();
                }
                self.place(desc, there.motion, there.activity);
            }
        }
        let known = |id: JointId| {
            let joint = before.joints().get(id)?;
            let gone = joint.bodies.iter().any(|body| removed.contains(body));
            (!gone).then_some(*joint)
        };
        let joints: Vec<_> = (self.scene.joints().iter())
            .filter(|(id, joint)| known(*id).as_ref() != Some(joint))
            .map(|(id, joint)| (id, *joint))
            .collect();
        for (id, joint) in joints {
            self.record_event(SceneEvent::JointAdded { id, joint });
        }
    }

    /// Removes bodies that were deleted or whose shape changes under them; returns those bodies.
    fn remove_differing(&mut self, before: &Scene, clients: &mut Clients) -> BTreeSet<BodyId> {
        let reshaped = self.differing_shapes(before);
        let is_gone =
            |id: BodyId, shape: ShapeId| self.scene.body(id).is_none() || reshaped.contains(&shape);
        let removed: BTreeSet<BodyId> = (before.bodies())
            .filter(|desc| is_gone(desc.id, desc.shape))
            .map(|desc| desc.id)
            .collect();
        let joints: Vec<JointId> = (before.joints().iter())
            .filter(|(id, joint)| {
                let goes_with_body = joint.bodies.iter().any(|body| removed.contains(body));
                self.scene.joints().get(*id).is_none() && !goes_with_body
            })
            .map(|(id, _)| id)
            .collect();
        for id in joints {
            self.record_event(SceneEvent::JointRemoved { id });
        }
        for id in &removed {
            self.streams.remove(*id);
            self.authority_table.remove(*id, clients);
            if self.scene.body(*id).is_none() {
                self.load.remove_body();
            }
            let cause = RemovalCause::Command;
            self.record_event(SceneEvent::BodyRemoved { id: *id, cause });
        }
        removed
    }

    /// The shapes that are added, removed or others.
    fn differing_shapes(&self, before: &Scene) -> BTreeSet<ShapeId> {
        let ids = before.shapes().chain(self.scene.shapes()).map(|(id, _)| id);
        ids.filter(|id| before.shape(*id) != self.scene.shape(*id))
            .collect()
    }

    /// Refuses a command that was applied before.
    fn refuse_late(author: &Author, error: CommandError, clients: &mut Clients) {
        if clients.member(author.member).is_some() {
            let number = author.number;
            clients.send(author.member, &ServerMessage::Refused { number, error });
        }
    }

    /// Informs all members that the engine failed for good; nothing moves any more.
    pub(super) fn fault(&mut self, cause: FaultCause, clients: &mut Clients) {
        self.faulted = true;
        self.observer.incident(Incident::Faulted);
        self.next_step = None;
        let tick = self.scene.tick();
        tracing::error!(
            tick = tick.value(),
            ?cause,
            "the engine failed; the scene stands still"
        );
        self.record_event(SceneEvent::SceneFaulted { tick, cause });
        self.send_scene_events(clients);
    }
}
