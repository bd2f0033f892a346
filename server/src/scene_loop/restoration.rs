//! A scene whose engine failed continues, or stands still with a reason.
//!
//! The restored scene is compared with what the members know, and they learn the difference by ordinary scene events:
//! streams, tracks and sessions continue.

use std::collections::BTreeSet;

use rhumb_protocol::Span;
use rhumb_protocol::message::{FaultCause, RemovalCause, SceneEvent, ServerMessage};
use rhumb_protocol::scene::{CommandError, JointId, ShapeId};
use rhumb_reckoning::BodyId;

use super::RunningScene;
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::clients::Clients;
use crate::event_monitor::EventKey;
use crate::observer::Incident;
use crate::record::Author;
use crate::rollback::{FailedIn, Restoration};
use crate::scene::{Scene, Stepped};

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
        Checkpoint::of(&self.scene, self.rollback.way_to(&self.scene))
    }

    /// Steps; a scene whose engine fails is restored first. `None` if it stands still.
    pub(super) fn step_or_restore(&mut self, clients: &mut Clients) -> Option<Stepped> {
        if let Ok(stepped) = self.scene.step() {
            return Some(stepped);
        }
        let restored = self.restore(FailedIn::Step, clients);
        let stepped = restored.and_then(|left_out| {
            for author in left_out {
                Self::refuse_late(&author, clients);
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
        self.observer.incident(Incident::EnginePanicked);
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
            "the engine failed; the scene continues without the commands that it failed on"
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

    /// Removes what is there no more, and bodies whose shape changes under them; returns those bodies.
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
            if self.scene.body(*id).is_none() {
                self.authority_table.remove(*id, clients);
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
    fn refuse_late(author: &Author, clients: &mut Clients) {
        if clients.member(author.member).is_some() {
            let refused = ServerMessage::Refused {
                number: author.number,
                error: CommandError::EngineFailed,
            };
            clients.send(author.member, &refused);
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
