//! What a scene needs of a physics engine, in a few methods.
//!
//! Knows no ticks, no members and no checks: a scene hands it only what it has checked. Invariants: whatever leaves an
//! engine is finite and inside the world; after a fault it steps and moves nothing any more.

mod kinematic_target;
mod rapier;
mod rapier_body;
mod rapier_solid;
mod rapier_workers;

use core::fmt;

use glam::{Quat, Vec3};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{BodyKind, Joint, JointId, Material, Shape, ShapeId};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Twist};

pub use rapier::RapierEngine;
pub use rapier_solid::{bulk, hull_of};
pub use rapier_workers::{Workers, WorkersError};

/// A body to be put into an engine, with everything that its config left to the scene filled in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NewBody {
    /// Its name; no body of the engine has its index.
    pub id: BodyId,
    /// Who moves it.
    pub kind: BodyKind,
    /// Its solid, one that the engine was given.
    pub shape: ShapeId,
    /// Its surface and substance.
    pub material: Material,
    /// How its free motion dies down.
    pub damping: Damping,
    /// Factor on the scene's gravity.
    pub gravity_scale: f32,
    /// Whether the axis of its spin wanders when its moments of inertia differ.
    pub gyroscopic: bool,
    /// Whether what touches it can turn it.
    pub turns: bool,
    /// Where it is, and how it moves.
    pub motion: BodyState,
}

/// What acts on a dynamic body, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// At the centre of mass during the next step, N.
    Force(Vec3),
    /// During the next step, N·m.
    Torque(Vec3),
    /// At the centre of mass at once, N·s.
    Impulse(Vec3),
    /// At once, N·m·s.
    TorqueImpulse(Vec3),
}

/// A world of rigid bodies that can be stepped.
///
/// Methods other than [`Engine::step`] and [`Engine::add_shape`] never fail: a body that is not there is passed over, and an engine that breaks
/// is faulted from then on. A change that changes nothing (the pose a body has, no force) wakes nothing.
pub trait Engine: Send {
    /// Makes a solid known under a name that is free.
    ///
    /// # Errors
    ///
    /// [`UnusableShape`] when it cannot make one; then nothing has changed.
    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape>;

    /// Forgets a solid that no body has.
    fn remove_shape(&mut self, id: ShapeId);

    /// Puts a body in.
    fn add(&mut self, body: &NewBody);

    /// Takes a body out, with its joints; what rested on it wakes.
    fn remove(&mut self, id: BodyId);

    /// Holds two bodies together under a name that is free, and wakes them.
    fn add_joint(&mut self, id: JointId, joint: &Joint);

    /// Lets go of what a joint held, and wakes it; one that went with a body is passed over.
    fn remove_joint(&mut self, id: JointId);

    /// Puts a static or dynamic body elsewhere and wakes what it touched; a kinematic one goes there in the next step.
    ///
    /// A kinematic body then stands still, unless a velocity is set after the pose.
    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat);

    /// Gives a dynamic body these velocities, or makes a kinematic one keep them.
    fn set_velocity(&mut self, id: BodyId, twist: Twist);

    /// Pushes a dynamic body.
    fn push(&mut self, id: BodyId, push: Push);

    /// Changes what pulls at every body, m/s², and wakes them all.
    fn set_gravity(&mut self, gravity: Vec3);

    /// Steps once and adds to `lost`, in the order of ids, the bodies that are gone because they left the world or are
    /// no longer finite.
    ///
    /// # Errors
    ///
    /// [`EngineFault`] in the step that broke, and in each one after it.
    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault>;

    /// Adds what the last step changed, in the order of ids: each body that is awake, and once each that fell asleep or
    /// was a static one that had been put elsewhere.
    fn observe(&self, out: &mut Vec<Observation>);

    /// One body as it is now, static ones as asleep.
    fn observe_one(&self, id: BodyId) -> Option<Observation>;

    /// How a body resists being turned, if it tumbles when it is free: dynamic, gyroscopic, of unequal moments.
    fn inertia(&self, id: BodyId) -> Option<Inertia>;

    /// Adds, for each body that touches this one after the last step, where they do so deepest.
    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>);

    /// Bodies that the last step left awake.
    fn awake_count(&self) -> usize;

    /// Why it steps no more, if so.
    fn fault(&self) -> Option<EngineFault>;
}

/// Where a body touches another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The other.
    pub with: BodyId,
    /// Metres, world frame: on the body that was asked about.
    pub point: Vec3,
    /// From the other towards the body that was asked about, unit, world frame.
    pub normal: Vec3,
    /// Metres; negative: they overlap.
    pub separation: f32,
}

/// What an engine makes of a shape that has an inside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bulk {
    /// Its centre of mass, from where its numbers are counted. Metres.
    pub centre: Vec3,
    /// m³.
    pub volume: f32,
}

/// An engine cannot make a solid of a shape, though its numbers are within the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UnusableShape;

/// Why an engine steps no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EngineFault {
    /// It panicked; what it holds can no longer be trusted.
    Panicked,
}

impl fmt::Display for EngineFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Panicked => f.write_str("the physics engine panicked"),
        }
    }
}

impl core::error::Error for EngineFault {}
