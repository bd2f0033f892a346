//! The rights of members in a scene, and the checks of the server.

use std::collections::BTreeSet;

use rhumb_protocol::Peer;
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{Command, CommandError, Locomotion, Shape, ShapeId};
use rhumb_reckoning::BodyId;

use super::SceneRunner;
use crate::admission;
use crate::clients::Clients;
use crate::engine::{BakedShape, Baker, UnusableShape};
use crate::member::Member;
use crate::record::Record;
use crate::rights::{self, Ownership, Permit, Refused, Request};

impl SceneRunner {
    /// Decides whether a member may make a request.
    pub(super) fn check(
        &self,
        clients: &Clients,
        peer: Peer,
        request: Request<'_>,
    ) -> Result<(), Refused> {
        let client = clients.get(peer).filter(|client| client.member.is_some());
        let client = client.ok_or(Refused::NotAllowed)?;
        rights::check(&client.permit, &self.ownership, request)
    }

    /// Decides whether a client may subscribe to another stream.
    pub(super) fn check_stream(
        &self,
        permit: &Permit,
        choice: StreamChoice,
        clients: &Clients,
    ) -> Result<(), Denial> {
        let members = clients.members_of(permit.client.as_ref());
        let mut streams: BTreeSet<StreamId> = members.flat_map(Member::streams).collect();
        let wanted = self.streams.of_choice(choice);
        streams.extend(wanted);
        let streams = streams.len() + usize::from(wanted.is_none());
        let allowed = rights::check(permit, &self.ownership, Request::Subscribe { streams });
        allowed.map_err(|_| Denial::TooManyStreams)
    }

    /// The function that makes the solid of a shape that a member may add; `None` if the command is refused anyway, or if
    /// the engine makes solids only by itself.
    pub(crate) fn baker_for(&self, permit: &Permit, id: ShapeId, shape: &Shape) -> Option<Baker> {
        let shape = shape.clone();
        let command = Command::AddShape { id, shape };
        let request = Request::Command(&command, self.config());
        let allowed = rights::check(permit, &self.ownership, request);
        allowed.ok().and_then(|()| self.scene.baker_for(id))
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
        peer: Peer,
        command: &Command,
        clients: &Clients,
    ) -> Result<(), CommandError> {
        self.check(clients, peer, Request::Command(command, self.config()))?;
        self.apply(peer, command, clients)?;
        let client = clients.name(peer).cloned();
        self.ownership.note(client.as_ref(), command);
        let tick = self.scene.tick();
        if let (Some(client), Some(journal)) = (client, self.scene.journal_mut())
            && Ownership::concerns(command)
        {
            journal.push(tick, &Record::Owned(client));
        }
        Ok(())
    }

    /// Carries out a command if the server admits the body that it adds.
    pub(super) fn apply_within_load(&mut self, command: &Command) -> Result<(), CommandError> {
        match command {
            // Its numbers come before what the server admits.
            Command::AddBody { .. } => command.check().map_err(CommandError::Invalid)?,
            Command::SetLocomotion { id, locomotion } => {
                return self.apply_locomotion(command, *id, locomotion);
            }
            Command::ChangeBody { .. } => {
                let applied = self.scene.apply(command);
                self.reserve_locomotion();
                return applied;
            }
            _ => return self.scene.apply(command),
        }
        if self.scene.body_count() as u64 >= self.settings.limits.bodies_per_scene {
            return Err(CommandError::TooManyBodies);
        }
        if !self.load.add_body() {
            let retry_seconds = admission::RETRY_SECONDS;
            return Err(CommandError::Overloaded { retry_seconds });
        }
        let applied = self.scene.apply(command);
        if applied.is_err() {
            self.load.remove_body();
        }
        applied
    }

    /// Makes a body a character or a vehicle if the server admits what it costs.
    fn apply_locomotion(
        &mut self,
        command: &Command,
        id: BodyId,
        locomotion: &Locomotion,
    ) -> Result<(), CommandError> {
        command.check().map_err(CommandError::Invalid)?;
        let before = admission::locomotion_steps(self.scene.locomotion(id).into_iter());
        let others = admission::locomotion_steps(self.scene.locomotions()) - before;
        let asked = admission::locomotion_steps(std::iter::once(locomotion));
        if !self.load.set_locomotion(others + asked) {
            let retry_seconds = admission::RETRY_SECONDS;
            return Err(CommandError::Overloaded { retry_seconds });
        }
        let applied = self.scene.apply(command);
        if applied.is_err() {
            self.reserve_locomotion();
        }
        applied
    }

    /// Reserves what the characters and vehicles of the scene cost now.
    pub(super) fn reserve_locomotion(&mut self) {
        let steps = admission::locomotion_steps(self.scene.locomotions());
        let _ = self.load.set_locomotion(steps);
    }

    /// Forgets the owner of a body that has left the scene.
    pub(super) fn forget_body(&mut self, id: BodyId) {
        self.ownership.remove_body(id);
        self.load.remove_body();
        self.reserve_locomotion();
    }
}
