//! Commands to a scene, and what they change for its streams and members.

use bytes::Bytes;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{RemovalCause, SceneEvent};
use rhumb_protocol::scene::{BodyDesc, Command, CommandError, Shape, ShapeId};
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::{BodyId, BodyState};

use super::RunningScene;
use crate::admission;
use crate::clients::{Clients, SceneClient};
use crate::engine::{BakedShape, Baker, UnusableShape};
use crate::permit::Permit;
use crate::record::Author;
use crate::rights::{self, Rights};
use crate::streams;

impl RunningScene {
    /// The rights of a client.
    pub(super) fn rights<'a>(
        &'a self,
        peer: Peer,
        permit: &'a Permit,
        clients: &'a Clients,
    ) -> Rights<'a> {
        Rights {
            peer,
            permit,
            scene: &self.scene,
            is_faulted: self.faulted,
            owner: self.owner,
            ownership: &self.ownership,
            authority_table: &self.authority_table,
            clients,
            limits: &self.settings.limits,
        }
    }

    /// The same of a member; `None` for a client that is none.
    pub(super) fn rights_of<'a>(&'a self, peer: Peer, clients: &'a Clients) -> Option<Rights<'a>> {
        let (permit, _) = clients.get(peer).and_then(SceneClient::membership)?;
        Some(self.rights(peer, permit, clients))
    }

    /// The function that makes the solid of a shape that a member may add; `None` if the command is refused anyway, or if
    /// the engine makes solids only by itself.
    pub(crate) fn baker_for(&self, permit: &Permit, id: ShapeId, shape: &Shape) -> Option<Baker> {
        if self.faulted || self.is_log_full() {
            return None;
        }
        let ownership = &self.ownership;
        let has_share = rights::has_share_of_shapes(permit, ownership, &self.scene, shape);
        let shape = shape.clone();
        let command = Command::AddShape { id, shape };
        (has_share && rights::includes(permit, ownership, &command, self.config()))
            .then(|| self.scene.baker_for(id))?
    }

    /// Keeps a solid for the next command that adds its shape.
    pub(crate) fn put_baked(
        &mut self,
        id: ShapeId,
        shape: &Shape,
        baked: Result<BakedShape, UnusableShape>,
    ) {
        self.scene.put_baked(id, shape, baked);
    }

    /// Carries out a command of a member, and notes what now belongs to its client.
    pub(super) fn apply_of_member(
        &mut self,
        (peer, number): (Peer, u64),
        command: &Command,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        let rights = self.rights_of(peer, clients);
        rights.ok_or(CommandError::NotAllowed)?.command(command)?;
        if self.is_log_full() {
            let retry_seconds = admission::RETRY_SECONDS;
            return Err(CommandError::Overloaded { retry_seconds });
        }
        self.apply_and_announce(command, clients)?;
        let client = clients.name(peer).cloned();
        self.ownership.note(client.as_ref(), command);
        let member = peer;
        self.scene
            .record_mut()
            .attribute(Author { member, number }, client);
        Ok(())
    }

    /// Applies a command of a member or of the script, and records what it changed for the streams and the members.
    pub(super) fn apply_and_announce(
        &mut self,
        command: &Command,
        clients: &mut Clients,
    ) -> Result<(), CommandError> {
        self.copy_if_due();
        self.carry_out(command)?;
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
                self.remove_body(id, RemovalCause::Command, clients);
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
    pub(super) fn announce_shape(&mut self, id: ShapeId, shape: Shape) {
        let from = self.unsent.len();
        self.record_event(SceneEvent::ShapeAdded { id, shape });
        let event = Bytes::copy_from_slice(&self.unsent[from..]);
        self.shape_events.insert(id, event);
    }

    /// Records that a shape is gone.
    pub(super) fn forget_shape(&mut self, id: ShapeId) {
        self.shape_events.remove(&id);
        self.record_event(SceneEvent::ShapeRemoved { id });
    }

    /// Places a new or changed body in every stream: both ends predict it by its description from the newest tick on.
    pub(super) fn place(&mut self, desc: BodyDesc, motion: BodyState, activity: Activity) {
        let (tick, tumbles) = (self.scene.tick(), self.scene.inertia(desc.id).is_some());
        let track = streams::first_track(tick, (motion, activity), &desc, tumbles);
        if let Some(parameters) = streams::parameters(&self.scene, desc.id) {
            self.streams.insert(desc.id, &parameters, track, motion);
        }
        self.record_event(streams::scene_event(&self.scene, desc, track, None));
    }

    /// Carries out a command if the scene and the server admit it.
    fn carry_out(&mut self, command: &Command) -> Result<(), CommandError> {
        let (limits, load) = (&self.settings.limits, &mut self.load);
        rights::admit(command, &self.scene, &self.authority_table, limits, load)?;
        let applied = self.scene.apply(command);
        match command {
            Command::AddBody { .. } if applied.is_err() => self.load.remove_body(),
            Command::SetLocomotion { .. } if applied.is_err() => self.reserve_locomotion(),
            // A body that changes may cease to be a character.
            Command::ChangeBody { .. } => self.reserve_locomotion(),
            _ => {}
        }
        applied
    }

    /// Reserves what the characters and vehicles of the scene cost now.
    pub(super) fn reserve_locomotion(&mut self) {
        let steps = admission::locomotion_steps(self.scene.locomotions());
        let _ = self.load.set_locomotion(steps);
    }

    /// Removes what the scene keeps of a body that has left it.
    pub(super) fn remove_body(&mut self, id: BodyId, cause: RemovalCause, clients: &mut Clients) {
        self.streams.remove(id);
        self.authority_table.remove(id, clients);
        self.ownership.remove_body(id);
        self.load.remove_body();
        self.reserve_locomotion();
        self.record_event(SceneEvent::BodyRemoved { id, cause });
    }
}
