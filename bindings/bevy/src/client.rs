//! The client of the scene that an app is a member of, as a resource.

use std::collections::BTreeMap;
use std::time::Duration;

use bevy_ecs::entity::Entity;
use bevy_ecs::resource::Resource;
use bevy_math::{Quat, Vec3};
use bevy_platform::cell::SyncCell;
use rhumb_bindings::{ObjectChange, SceneFollower};
use rhumb_client::scene::{BodyBuilder, Command, Shape, Stepping};
use rhumb_client::{
    BodyId, Client, ClientError, ErrorBound, Event, PipelineDepth, RefusedRequests,
};

use crate::axes::{AXES, angular_in, rotation_in, torque_in, vector_in};

/// The client of the scene that the app is a member of.
///
/// Insert it as a resource, or let [`RhumbJoin`](crate::RhumbJoin) do it. Removing it leaves the scene and despawns the
/// entities of its bodies.
#[derive(Resource)]
pub struct RhumbClient {
    client: SyncCell<Client>,
    /// The entity of each body.
    follower: SceneFollower<Entity>,
    /// Bodies of unanswered commands for which entities of the application stand, by the number of the command.
    additions: BTreeMap<u64, BodyId>,
}

impl RhumbClient {
    /// The scene of a client that has joined it.
    #[must_use]
    pub fn new(client: Client) -> Self {
        Self {
            follower: SceneFollower::new(&client, AXES),
            client: SyncCell::new(client),
            additions: BTreeMap::new(),
        }
    }

    /// The client, for what this type does not offer: queries, authority, streams, statistics.
    ///
    /// A call that waits for the server makes the frame wait too. The plug-in takes the client's events.
    pub fn inner(&mut self) -> &mut Client {
        self.client.get()
    }

    /// The client, for use without Bevy.
    #[must_use]
    pub fn into_inner(self) -> Client {
        SyncCell::to_inner(self.client)
    }

    /// Steps by a member, or by the server's clock.
    #[must_use]
    pub const fn stepping(&self) -> Stepping {
        self.follower.stepping()
    }

    /// Simulated time from one step of a lockstep client to the next. The app's fixed time step should be the same:
    /// `Time::<Fixed>::from_duration(client.fixed_step())`.
    #[must_use]
    pub const fn fixed_step(&self) -> Duration {
        self.follower.fixed_step()
    }

    /// Fixed steps at which the requested tick of a lockstep scene was not there yet. Its bodies then stood still.
    #[must_use]
    pub const fn late_steps(&self) -> u64 {
        self.follower.late_steps()
    }

    /// True if the scene has ended; [`RhumbEnded`](crate::RhumbEnded) had the reason.
    #[must_use]
    pub const fn is_ended(&self) -> bool {
        self.follower.is_ended()
    }

    /// The entity of a body; `None` until the body is shown.
    #[must_use]
    pub fn entity(&self, id: BodyId) -> Option<Entity> {
        self.follower.object(id).copied()
    }

    /// The shape of a body, in the axes of its entity; `None` for a body that the client's copy does not have.
    #[must_use]
    pub fn shape(&mut self, id: BodyId) -> Option<&Shape> {
        let replica = self.client.get().replica()?;
        replica.shape(replica.body(id)?.shape)
    }

    /// How far any point of a body may be from its true place in the state that [`RhumbState`] has; `None` for a body
    /// without one.
    #[must_use]
    pub fn error_bound(&mut self, id: BodyId) -> Option<ErrorBound> {
        self.client.get().error_bound(id)
    }

    /// Adds a body. An entity appears when the server has placed it.
    ///
    /// # Errors
    ///
    /// As [`Client::add_body`].
    pub fn add_body(&mut self, body: BodyBuilder) -> Result<BodyId, ClientError> {
        self.client.get().add_body(body)
    }

    /// Adds a body for which an entity of the application stands. The entity gets its components when the server has
    /// placed the body, and is despawned with the body, also if the server refuses the body or it is removed before it is
    /// shown. If the application despawns the entity before, the body has none.
    ///
    /// # Errors
    ///
    /// As [`Client::add_body`].
    pub fn add_body_as(
        &mut self,
        entity: Entity,
        body: BodyBuilder,
    ) -> Result<BodyId, ClientError> {
        let client = self.client.get();
        let id = client.add_body(body)?;
        let addition = client.last_command();
        self.additions.extend(addition.map(|number| (number, id)));
        self.follower.reserve(id, entity);
        Ok(id)
    }

    /// Removes a body for all members of the scene; returns the command's number.
    ///
    /// # Errors
    ///
    /// As [`Client::command`], as all commands below.
    pub fn remove_body(&mut self, id: BodyId) -> Result<u64, ClientError> {
        self.command(Command::RemoveBody { id })
    }

    /// Changes a body's momentum at once: N·s, at its centre of mass.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn apply_impulse(&mut self, id: BodyId, impulse: Vec3) -> Result<u64, ClientError> {
        let impulse = vector_in(impulse);
        self.command(Command::Impulse { id, impulse })
    }

    /// Changes a body's angular momentum at once: N·m·s, world axes.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn apply_torque_impulse(&mut self, id: BodyId, impulse: Vec3) -> Result<u64, ClientError> {
        let impulse = torque_in(impulse);
        self.command(Command::TorqueImpulse { id, impulse })
    }

    /// Puts a body's centre of mass elsewhere, and turns the body: a kinematic one as [`Command::SetPose`] says.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn set_pose(
        &mut self,
        id: BodyId,
        position: Vec3,
        rotation: Quat,
    ) -> Result<u64, ClientError> {
        self.command(Command::SetPose {
            id,
            position: vector_in(position),
            rotation: rotation_in(rotation),
        })
    }

    /// Sets a body's velocity, m/s and rad/s.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn set_velocity(
        &mut self,
        id: BodyId,
        linear: Vec3,
        angular: Vec3,
    ) -> Result<u64, ClientError> {
        self.command(Command::SetVelocity {
            id,
            linear: vector_in(linear),
            angular: angular_in(angular),
        })
    }

    /// Queues any command. Its vectors are in Bevy's axes, which are those of the scene.
    ///
    /// # Errors
    ///
    /// As [`Client::command`].
    pub fn command(&mut self, command: Command) -> Result<u64, ClientError> {
        self.client.get().command(command)
    }

    /// Computes the view of the present, or of the next step; returns whether there is a new view.
    pub(crate) fn advance(&mut self, depth: PipelineDepth) -> Result<bool, ClientError> {
        self.follower.advance(self.client.get(), depth)
    }

    /// Refusals of the server, each once.
    pub(crate) fn take_refused(&mut self) -> Option<RefusedRequests> {
        self.follower.take_refused()
    }

    /// True before the first view is shown.
    pub(crate) const fn is_new(&self) -> bool {
        self.follower.is_new()
    }

    /// Changes of the entities that show the client's view.
    pub(crate) fn changes(&mut self) -> Vec<ObjectChange<Entity>> {
        self.follower.changes(self.client.get().view())
    }

    /// The body that an event takes away, or keeps out of the scene.
    pub(crate) fn note(&mut self, event: &Event) -> Option<BodyId> {
        match *event {
            Event::BodyRemoved { id, .. } => Some(id),
            Event::Refused { number, .. } => self.additions.remove(&number),
            Event::Applied { through, .. } => {
                self.additions.retain(|number, _| *number > through);
                None
            }
            _ => None,
        }
    }

    /// The entity that the application has for a body, if any.
    pub(crate) fn take_reserved(&mut self, id: BodyId) -> Option<Entity> {
        self.follower.take_reserved(id)
    }

    pub(crate) fn set_entity(&mut self, id: BodyId, entity: Entity) {
        self.follower.set_object(id, entity);
    }

    pub(crate) const fn end(&mut self) {
        self.follower.end();
    }
}
