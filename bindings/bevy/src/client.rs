//! The client of the scene that an app is in: its way in, its messages.
//!
//! Axes and units come from `rhumb-bindings`, the one place that has them for every engine. This file changes the types
//! alone: Bevy's maths and the client's are two versions of one crate.

use std::collections::BTreeMap;
use std::error::Error;
use std::io;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use bevy_ecs::entity::Entity;
use bevy_ecs::message::{Message, MessageWriter};
use bevy_ecs::resource::Resource;
use bevy_ecs::system::{Commands, ResMut};
use bevy_math::{Quat, Vec3};
use bevy_platform::cell::SyncCell;
use rhumb_bindings::{Coordinates, ObjectChange, SceneFollower};
use rhumb_client::scene::{BodyBuilder, Command, Shape, Stepping};
use rhumb_client::{
    BodyId, Client, ClientError, ErrorBound, Event, PipelineDepth, RefusedRequests, Tick, glam,
};

/// The coordinates of Bevy.
const AXES: Coordinates = Coordinates::BEVY;

/// A position, velocity, force or impulse of Bevy, for the client.
fn vector_in(vector: Vec3) -> glam::Vec3 {
    AXES.vector_in(glam::Vec3::from_array(vector.to_array()))
}

/// A torque or angular impulse of Bevy, for the client.
fn torque_in(torque: Vec3) -> glam::Vec3 {
    AXES.torque_in(glam::Vec3::from_array(torque.to_array()))
}

/// An angular velocity of Bevy, for the client.
fn angular_in(angular: Vec3) -> glam::Vec3 {
    AXES.angular_in(glam::Vec3::from_array(angular.to_array()))
}

/// A rotation of Bevy, for the client.
fn rotation_in(rotation: Quat) -> glam::Quat {
    AXES.rotation_in(glam::Quat::from_array(rotation.to_array()))
}

/// A vector in Bevy's axes.
pub(crate) fn vector(vector: glam::Vec3) -> Vec3 {
    Vec3::from_array(vector.to_array())
}

/// A rotation in Bevy's axes.
pub(crate) fn rotation(rotation: glam::Quat) -> Quat {
    Quat::from_array(rotation.to_array())
}

/// An event of the scene: a contact, a refused command, a removed body, an interrupted connection.
#[derive(Clone, Debug, PartialEq, Message)]
pub struct RhumbMessage {
    /// The newest complete tick when the data with which it arrived was read. States of later ticks show its effect.
    pub after: Tick,
    /// The event.
    pub event: Event,
}

/// The scene has ended: its connection is lost, it was deleted, its engine failed, or the server denied a step.
///
/// Written once for a scene. Its entities stay where they are until [`RhumbClient`](crate::RhumbClient) is removed.
#[derive(Debug, Message)]
pub struct RhumbEnded {
    /// The reason.
    pub error: ClientError,
}

/// A [`RhumbJoin`](crate::RhumbJoin) did not join its scene.
#[derive(Debug, Message)]
pub struct RhumbJoinFailed {
    /// The reason, such as an [`OpenError`](rhumb_client::OpenError).
    pub error: Box<dyn Error + Send + Sync>,
}

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

    /// The client, for what this type does not offer: queries, authority, streams, cells, statistics.
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
        let client = self.client.get();
        client.replica()?.shape(client.body(id)?.shape)
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

/// A client on its way into a scene.
///
/// Insert it as a resource. The plug-in replaces it by a [`RhumbClient`], or writes [`RhumbJoinFailed`].
#[derive(Debug, Resource)]
pub struct RhumbJoin {
    /// `None` once its client is taken over.
    thread: Option<JoinHandle<Result<Client, Box<dyn Error + Send + Sync>>>>,
}

impl RhumbJoin {
    /// Calls `join` on a thread of its own. It connects, joins, and may furnish the scene.
    ///
    /// # Errors
    ///
    /// The system starts no thread.
    pub fn start(
        join: impl FnOnce() -> Result<Client, Box<dyn Error + Send + Sync>> + Send + 'static,
    ) -> io::Result<Self> {
        let thread = Builder::new().name("rhumb-bevy-join".to_owned());
        Ok(Self {
            thread: Some(thread.spawn(join)?),
        })
    }
}

/// Takes over the client of a thread that has ended.
pub(crate) fn finish_join(
    mut join: ResMut<'_, RhumbJoin>,
    mut commands: Commands<'_, '_>,
    mut failures: MessageWriter<'_, RhumbJoinFailed>,
) {
    let Some(thread) = join.thread.take_if(|thread| thread.is_finished()) else {
        return;
    };
    commands.remove_resource::<RhumbJoin>();
    match thread.join() {
        Ok(Ok(client)) => commands.insert_resource(RhumbClient::new(client)),
        Ok(Err(error)) => {
            failures.write(RhumbJoinFailed { error });
        }
        Err(_) => {
            let error = "the function that was to join the scene panicked; its message is on standard error".into();
            failures.write(RhumbJoinFailed { error });
        }
    }
}

#[cfg(test)]
mod tests {
    use bevy_transform::components::Transform;

    use super::*;

    #[test]
    fn up_in_bevy_is_up_in_rhumb_and_a_metre_is_a_metre() {
        let up = Transform::IDENTITY.up() * 2.0;
        assert_eq!(vector_in(up), glam::Vec3::Y * 2.0);
        assert_eq!(vector(AXES.vector_out(glam::Vec3::Y * 2.0)), up);
    }

    #[test]
    fn bevys_axes_are_as_handed_as_the_conversion_says() {
        let at = Transform::IDENTITY;
        let is_right_handed = at.right().cross(*at.up()).dot(*at.back()) > 0.0;
        assert_ne!(is_right_handed, AXES.is_left_handed());
    }

    #[test]
    fn a_turn_takes_a_vector_to_the_same_place_in_both() {
        let (turn, arm) = (
            Quat::from_euler(bevy_math::EulerRot::YXZ, 0.3, -0.8, 1.9),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let inside = rotation_in(turn) * vector_in(arm);
        assert!(vector(AXES.vector_out(inside)).distance(turn * arm) < 1e-5);
        assert_eq!(rotation(AXES.rotation_out(rotation_in(turn))), turn);
    }

    #[test]
    fn a_spin_and_a_torque_come_back_as_they_were() {
        let spin = Vec3::new(0.5, -2.0, 7.0);
        assert_eq!(vector(AXES.angular_out(angular_in(spin))), spin);
        // Metres and kilograms: a torque has the same number inside.
        assert_eq!(torque_in(spin), angular_in(spin));
    }
}
