//! Components of the entities that stand for bodies.
//!
//! The plug-in writes them. What an application writes into them changes no body: commands do.

use bevy_ecs::component::Component;
use bevy_math::{Quat, Vec3};
use bevy_transform::components::Transform;
use rhumb_bindings::StateRecord;
use rhumb_client::{BodyId, ErrorBound};

use crate::axes::{rotation, vector};

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
