//! The client of the scene that an app is a member of, as a resource.
//!
//! It knows which entity stands for which body. An invariant: each body of the view that the
//! entities show has an entity here, also one that the application despawned.

use std::collections::HashMap;
use std::time::Duration;

use bevy_ecs::entity::Entity;
use bevy_ecs::resource::Resource;
use bevy_math::{Quat, Vec3};
use bevy_platform::cell::SyncCell;
use rhumb_client::scene::{BodyBuilder, Command, Shape, Stepping};
use rhumb_client::{BodyId, Client, ClientError, ErrorBound, PipelineDepth, View};

use crate::axes::{
    angular_in, angular_out, rotation_in, rotation_out, torque_in, vector_in, vector_out,
};
use crate::body::RhumbState;

/// The client of the scene that the app is a member of.
///
/// Insert it as a resource, or let [`RhumbJoin`](crate::RhumbJoin) do it. Removing it leaves the scene and despawns the
/// entities of its bodies.
#[derive(Resource)]
pub struct RhumbClient {
    client: SyncCell<Client>,
    stepping: Stepping,
    fixed_step: Duration,
    /// By body, once the view has it.
    entities: HashMap<BodyId, Entity>,
    /// Entities of the application for bodies that the view does not have yet.
    reserved: HashMap<BodyId, Entity>,
    /// Refreshes of the view that the entities show; `None` before the first one.
    shown: Option<u64>,
    /// True while the requested tick of a lockstep scene is not shown.
    is_waiting: bool,
    late_steps: u64,
    is_ended: bool,
}

/// A change of the entities, which the view asks for.
pub(crate) enum EntityChange {
    /// A body has this state.
    Show(BodyId, RhumbState),
    /// An entity stands for no body any more.
    Despawn(Entity),
}

impl RhumbClient {
    /// The scene of a client that has joined it.
    #[must_use]
    pub fn new(client: Client) -> Self {
        let config = client.config();
        let interval = config.publish_schedule.publish_interval.get();
        let seconds = config.integrator.rate.step().seconds() * f64::from(interval);
        Self {
            stepping: config.stepping,
            fixed_step: Duration::from_secs_f64(seconds),
            client: SyncCell::new(client),
            entities: HashMap::new(),
            reserved: HashMap::new(),
            shown: None,
            is_waiting: false,
            late_steps: 0,
            is_ended: false,
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
        self.stepping
    }

    /// Simulated time from one step of a lockstep client to the next. The app's fixed time step should be the same:
    /// `Time::<Fixed>::from_duration(client.fixed_step())`.
    #[must_use]
    pub const fn fixed_step(&self) -> Duration {
        self.fixed_step
    }

    /// Fixed steps at which the requested tick of a lockstep scene was not there yet. Its bodies then stood still.
    #[must_use]
    pub const fn late_steps(&self) -> u64 {
        self.late_steps
    }

    /// True if the scene goes on no more; [`RhumbEnded`](crate::RhumbEnded) had the reason.
    #[must_use]
    pub const fn is_ended(&self) -> bool {
        self.is_ended
    }

    /// The entity of a body; `None` until the body is shown.
    #[must_use]
    pub fn entity(&self, id: BodyId) -> Option<Entity> {
        self.entities.get(&id).copied()
    }

    /// The shape of a body, in the axes of its entity; `None` for a body that the client's copy does not have.
    #[must_use]
    pub fn shape(&mut self, id: BodyId) -> Option<&Shape> {
        let replica = self.client.get().replica()?;
        replica.shape(replica.body(id)?.shape)
    }

    /// How far any point of a body may be from its true place in the state that [`RhumbState`] has; `None` for a body
    /// without one, for a body that glides to a corrected pose, and between two ticks.
    #[must_use]
    pub fn error_bound(&mut self, id: BodyId) -> Option<ErrorBound> {
        let client = self.client.get();
        let view = client.view();
        let at = view.time().filter(|at| at.fraction == 0.0)?;
        match view.is_gliding(id) {
            true => None,
            false => client.error_bound_at(id, at.tick),
        }
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
    /// placed the body, and is despawned with the body.
    ///
    /// # Errors
    ///
    /// As [`Client::add_body`].
    pub fn add_body_as(
        &mut self,
        entity: Entity,
        body: BodyBuilder,
    ) -> Result<BodyId, ClientError> {
        let id = self.client.get().add_body(body)?;
        self.reserved.insert(id, entity);
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

    /// Puts a body's centre of mass elsewhere, and turns the body.
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

    /// Goes on in time; returns whether there is a new view.
    pub(crate) fn advance(&mut self, depth: PipelineDepth) -> Result<bool, ClientError> {
        let client = self.client.get();
        if self.stepping == Stepping::FreeRunning {
            return client.poll().map(|_| true);
        }
        let is_late = self.is_waiting;
        if !is_late {
            client.request_tick()?;
            self.is_waiting = true;
        }
        // One wait for a tick at most: after a time-out, later frames only look.
        let shown = match depth == PipelineDepth::LOCKSTEP && !is_late {
            true => match client.wait(depth) {
                Err(ClientError::Timeout { .. }) => None,
                waited => Some(waited?),
            },
            false => client.try_wait(depth)?,
        };
        self.is_waiting = shown.is_none();
        self.late_steps += u64::from(self.is_waiting);
        Ok(shown.is_some())
    }

    /// True before the first view is shown.
    pub(crate) const fn is_new(&self) -> bool {
        self.shown.is_none()
    }

    /// Changes of the entities that show the client's view.
    pub(crate) fn changes(&mut self) -> Vec<EntityChange> {
        let view = self.client.get().view();
        let mut changes = Vec::new();
        let follows = self.shown.and_then(|shown| shown.checked_add(1)) == Some(view.refreshes());
        self.shown = Some(view.refreshes());
        if follows {
            let gone = view
                .removed()
                .iter()
                .filter_map(|id| self.entities.remove(id));
            changes.extend(gone.map(EntityChange::Despawn));
            changes.extend(view.changed().filter_map(|place| shown(view, place)));
        } else {
            // The application has computed views of its own: what they removed and changed is not known.
            let gone = self.entities.extract_if(|id, _| view.place(*id).is_none());
            changes.extend(gone.map(|(_, entity)| EntityChange::Despawn(entity)));
            changes.extend((0..view.ids().len()).filter_map(|place| shown(view, place)));
        }
        changes
    }

    /// The entity that the application has for a body, if any.
    pub(crate) fn take_reserved(&mut self, id: BodyId) -> Option<Entity> {
        self.reserved.remove(&id)
    }

    pub(crate) fn set_entity(&mut self, id: BodyId, entity: Entity) {
        self.entities.insert(id, entity);
    }

    pub(crate) const fn end(&mut self) {
        self.is_ended = true;
    }
}

/// The state of a body of a view; `None` before it has a pose.
fn shown(view: &View, place: usize) -> Option<EntityChange> {
    let position = view.positions()[place];
    let state = RhumbState {
        position: vector_out(position),
        rotation: rotation_out(view.rotations()[place]),
        linear_velocity: vector_out(view.linear_velocities()[place]),
        angular_velocity: angular_out(view.angular_velocities()[place]),
    };
    (position.is_finite()).then_some(EntityChange::Show(view.ids()[place], state))
}
