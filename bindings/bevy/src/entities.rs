//! The entities of a scene's bodies: components, spawning, moving, despawning.
//!
//! The plug-in writes the components. An application that writes into them changes no body: commands do. An entity that the
//! application has despawned is left alone; its body lives on.
//!
//! In a lockstep scene, the transform follows the state by one fixed step at most. A step without a new tick holds the
//! bodies still.

use bevy_ecs::change_detection::DetectChangesMut as _;
use bevy_ecs::component::Component;
use bevy_ecs::entity::Entity;
use bevy_ecs::query::{With, Without};
use bevy_ecs::system::{Commands, Query, Res, SystemParam};
use bevy_math::{Quat, Vec3};
use bevy_time::{Fixed, Time};
use bevy_transform::components::Transform;
use rhumb_bindings::{ObjectChange, StateRecord};
use rhumb_client::scene::Stepping;
use rhumb_client::{BodyId, ErrorBound};

use crate::client::{RhumbClient, rotation, vector};

/// The body that an entity stands for.
///
/// An application that despawns the entity hides the body; [`RhumbClient::remove_body`](crate::RhumbClient::remove_body)
/// removes it for all members of the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Component)]
#[component(immutable)]
#[require(Transform, RhumbState)]
pub struct RhumbBodyId(BodyId);

impl RhumbBodyId {
    pub(crate) const fn new(id: BodyId) -> Self {
        Self(id)
    }

    /// The body's id in its scene.
    #[must_use]
    pub const fn id(self) -> BodyId {
        self.0
    }
}

/// State of a body at the moment that the plug-in last computed: its centre of mass, in Bevy's axes.
///
/// In a lockstep scene it is that of a whole tick, and the transform follows it within one fixed step.
#[derive(Clone, Copy, Debug, PartialEq, Component)]
pub struct RhumbState {
    /// Metres.
    pub position: Vec3,
    /// Body → world.
    pub rotation: Quat,
    /// m/s; zero for a body at rest.
    pub linear_velocity: Vec3,
    /// rad/s about world axes; zero for a body at rest.
    pub angular_velocity: Vec3,
}

impl RhumbState {
    pub(crate) fn of(record: &StateRecord) -> Self {
        Self {
            position: vector(record.position),
            rotation: rotation(record.rotation),
            linear_velocity: vector(record.linear_velocity),
            angular_velocity: vector(record.angular_velocity),
        }
    }
}

impl Default for RhumbState {
    fn default() -> Self {
        Self {
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            linear_velocity: Vec3::ZERO,
            angular_velocity: Vec3::ZERO,
        }
    }
}

/// The bound of the error of a body: no point of it is farther from its true place, in metres.
///
/// Insert it where it is of use: the plug-in then writes it whenever it advances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Component)]
pub struct RhumbErrorBound {
    /// The bound on the [`RhumbState`], with what a glide has still to cover; `None` while nothing finite is known: a
    /// packet that may hold an update of the body is missing, or the view shows a moment of which the news has not arrived.
    ///
    /// A free-running client shows only moments whose news has arrived with
    /// [`delay_ticks`](rhumb_client::JoinOptions::delay_ticks) of the network's delay and a little more.
    pub metres: Option<f64>,
}

impl RhumbErrorBound {
    pub(crate) const fn of(bound: Option<ErrorBound>) -> Self {
        Self {
            metres: match bound {
                Some(ErrorBound::Within(distance)) => Some(distance.metres()),
                Some(ErrorBound::Unknown { .. }) | None => None,
            },
        }
    }
}

/// The pose at the fixed step before.
#[derive(Clone, Copy, Debug, PartialEq, Component)]
pub(crate) struct PoseBefore {
    position: Vec3,
    rotation: Quat,
}

impl PoseBefore {
    const fn of(state: &RhumbState) -> Self {
        Self {
            position: state.position,
            rotation: state.rotation,
        }
    }
}

/// Begins a fixed step: what was the newest pose is the one before.
pub(crate) fn begin_step(mut bodies: Query<'_, '_, (&RhumbState, &mut PoseBefore)>) {
    for (state, mut before) in &mut bodies {
        before.set_if_neq(PoseBefore::of(state));
    }
}

/// Writes the transforms of the frame's moment.
pub(crate) fn interpolate(
    time: Res<'_, Time<Fixed>>,
    mut bodies: Query<'_, '_, (&RhumbState, &PoseBefore, &mut Transform)>,
) {
    let share = time.overstep_fraction();
    for (state, before, mut transform) in &mut bodies {
        let drawn = Transform {
            translation: before.position.lerp(state.position, share),
            rotation: before.rotation.slerp(state.rotation, share),
            scale: transform.scale,
        };
        transform.set_if_neq(drawn);
    }
}

/// Access to the entities of bodies.
#[derive(SystemParam)]
pub(crate) struct BodyEntities<'w, 's> {
    commands: Commands<'w, 's>,
    shown: Query<'w, 's, Entity, With<RhumbBodyId>>,
    states: Query<
        'w,
        's,
        (
            &'static mut RhumbState,
            &'static mut Transform,
            Option<&'static PoseBefore>,
        ),
    >,
    /// Of the application's own entities.
    others: Query<'w, 's, &'static Transform, Without<RhumbState>>,
}

impl BodyEntities<'_, '_> {
    /// Makes the entities show the view of the scene's client.
    pub(crate) fn follow(&mut self, client: &mut RhumbClient) {
        if client.is_new() {
            // The app may have had another scene before.
            self.despawn_all();
        }
        for change in client.changes() {
            match change {
                ObjectChange::Destroy(entity) => self.despawn(entity),
                ObjectChange::Show(record) => {
                    let (id, state) = (record.body, RhumbState::of(&record));
                    match client.entity(id) {
                        Some(entity) => self.show(entity, state),
                        None => self.spawn(client, id, state),
                    }
                }
            }
        }
    }

    /// Despawns the entity of the application that waits for a body. The body is gone, and was never shown.
    pub(crate) fn despawn_reserved(&mut self, client: &mut RhumbClient, id: BodyId) {
        if let Some(entity) = client.take_reserved(id) {
            self.despawn(entity);
        }
    }

    /// Despawns the entities of all bodies.
    pub(crate) fn despawn_all(&mut self) {
        for entity in &self.shown {
            self.commands.entity(entity).try_despawn();
        }
    }

    fn despawn(&mut self, entity: Entity) {
        if let Ok(mut entity) = self.commands.get_entity(entity) {
            entity.try_despawn();
        }
    }

    fn show(&mut self, entity: Entity, state: RhumbState) {
        let Ok((mut known, mut transform, before)) = self.states.get_mut(entity) else {
            return;
        };
        *known = state;
        // In a lockstep scene the frame writes it, between this state and the one before.
        if before.is_none() {
            transform.translation = state.position;
            transform.rotation = state.rotation;
        }
    }

    /// Gives a body its entity.
    fn spawn(&mut self, client: &mut RhumbClient, id: BodyId, state: RhumbState) {
        let reserved = client.take_reserved(id);
        let scaled = reserved.and_then(|entity| self.others.get(entity).ok());
        let transform = Transform {
            translation: state.position,
            rotation: state.rotation,
            ..scaled.copied().unwrap_or_default()
        };
        let mut entity = match reserved {
            None => self.commands.spawn_empty(),
            Some(entity) => match self.commands.get_entity(entity) {
                Ok(commands) => commands,
                // The application has despawned it meanwhile, which hides the body.
                Err(_) => return client.set_entity(id, entity),
            },
        };
        client.set_entity(id, entity.id());
        entity.try_insert((RhumbBodyId::new(id), state, transform));
        if client.stepping() == Stepping::Lockstep {
            entity.try_insert(PoseBefore::of(&state));
        }
    }
}
