//! Interface between a scene and its physics engine.
//!
//! No ticks, members or checks here: a scene passes only checked values. Invariants: every value from an engine is
//! finite and inside the world; after a fault it neither steps nor moves anything.

use core::any::Any;
use core::fmt;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{ANGULAR_MAX, LINEAR_MAX};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, Contact, Joint, JointId, JumpFrom, LockedAxes,
    Locomotion, Material, Query, Shape, ShapeId, Sleep, WheelInput,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Twist};
use rhumb_solids::UnitMass;

/// A body's description for an engine, with the scene's defaults filled in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyProperties {
    /// Its description; its shape is known to the engine.
    pub desc: BodyDesc,
    /// Its surface and density.
    pub material: Material,
    /// Damping of its free motion.
    pub damping: Damping,
    /// Conditions under which it falls asleep.
    pub sleep: Sleep,
}

/// A push of a dynamic body, world frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Push {
    /// Force at the centre of mass during the next step, N.
    Force(Vec3),
    /// Force at a point during the next step: N, then metres.
    ForceAt(Vec3, Vec3),
    /// Torque during the next step, N·m.
    Torque(Vec3),
    /// Impulse at the centre of mass at once, N·s.
    Impulse(Vec3),
    /// Impulse at a point at once: N·s, then metres.
    ImpulseAt(Vec3, Vec3),
    /// Angular impulse at once, N·m·s.
    TorqueImpulse(Vec3),
}

/// Greatest speed that an engine gives a body, m/s: that of a command whose components are all the greatest, rounded up.
pub(super) const SPEED_MAX: f32 = LINEAR_MAX * ROOT_OF_THREE;
/// Greatest angular speed of a body at the beginning of a step, rad/s, likewise.
pub(super) const SPIN_MAX: f32 = ANGULAR_MAX * ROOT_OF_THREE;
const ROOT_OF_THREE: f32 = 1.7321;

/// A part of a scene that an engine may lack.
#[derive(Clone, Copy, Debug)]
pub enum EnginePart<'a> {
    /// A shape that a client adds.
    Shape(&'a Shape),
    /// A body that a client adds or changes.
    Body(&'a BodyProperties),
    /// A joint that a client adds or changes.
    Joint(&'a Joint),
    /// A character, a vehicle, or neither, for a body.
    Locomotion(&'a Locomotion),
}

/// A world of rigid bodies that can be stepped.
///
/// The contract between a scene and its engine:
///
/// - **Units and frames.** Metres, kilograms, seconds, radians; world frame, right-handed; a rotation turns body axes to
///   world axes; a body's origin is its centre of mass. Observations are f32.
/// - **Order.** A scene calls from one thread at a time: any number of changes, then [`Engine::step`], then what reads
///   the step: `observe`, `overloaded_joints`, `contacts`, `sensed`. `observe_one`, `query`, `copy` and `freeze` may come
///   at any time. Changes act from the next step on.
/// - **Arguments.** Every number is finite and within `limits.rs`; an id that is added is free; the shape of a body is
///   known; the bodies of a joint are enabled. A body or joint that is not there is ignored.
/// - **Determinism.** Equal configurations and equal calls give equal bits, in every run of one binary, whatever other
///   worlds the process has and however many threads. Nothing depends on the clock, on addresses, or on the calls that
///   read.
/// - **Missing parts.** [`Engine::supports`] says what an engine lacks; the client gets `Unsupported`. A shape that it
///   cannot make of allowed numbers is [`UnusableShape`], and the client gets `ShapeUnfit`; a query that it cannot
///   evaluate is [`UnanswerableQuery`], and the client gets `Unanswerable`. An engine without `copy` has scenes that end
///   with a fault; one without `freeze` has no data directory, and a server with one does not start.
/// - **Failure.** Only [`Engine::step`] and [`Engine::add_shape`] can fail. An engine that breaks is faulted from then on;
///   it may also panic, which the scene contains and which ends it.
/// - **Sleep.** A change without effect (the present pose, no force) wakes nothing.
pub trait Engine: Send {
    /// True if the engine has such a part at all; called before each change that brings one, and must not depend on the
    /// state of the world. A change that is not supported is not made.
    fn supports(&self, part: EnginePart<'_>) -> bool {
        let _ = part;
        true
    }

    /// Adds a solid under a free id. Lengths in metres, in the axes of the body, from its centre of mass.
    ///
    /// # Errors
    ///
    /// [`UnusableShape`] when no solid can be made; nothing has changed.
    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape>;

    /// A function that makes a solid of a shape, on any thread; `None` for an engine that makes them in `add_shape` only.
    /// Then a large shape holds its scene up.
    fn baker(&self) -> Option<Baker> {
        None
    }

    /// Adds a solid that the baker made under a free id.
    ///
    /// # Errors
    ///
    /// [`UnusableShape`] if it is none of this engine's; nothing has changed.
    fn add_baked(&mut self, id: ShapeId, baked: BakedShape) -> Result<(), UnusableShape> {
        let _ = (id, baked);
        Err(UnusableShape)
    }

    /// The largest moment of inertia that a body has from its shape and density, kg·m², before it is added; `None` if the
    /// body has a mass of its own, its shape is unknown, or the engine cannot say. A client gets `OutOfRange` by it.
    fn moment(&self, body: &BodyProperties) -> Option<f32> {
        let _ = body;
        None
    }

    /// Removes a solid that no body has.
    fn remove_shape(&mut self, id: ShapeId);

    /// Adds a body with this pose and these velocities (m/s, rad/s); no body of the engine has its index. A dynamic body is
    /// awake.
    fn add(&mut self, body: &BodyProperties, motion: BodyState);

    /// Replaces the properties of a body, and wakes it and what it touches. Its joints stay.
    ///
    /// `before`: its description until now. A body that becomes kinematic or fixed, or is disabled, stands still.
    fn change(&mut self, before: &BodyDesc, body: &BodyProperties);

    /// Removes a body with its joints; bodies that rested on it wake.
    fn remove(&mut self, id: BodyId);

    /// Joins two bodies under a free id, and wakes them. Anchors in metres from the centres of mass, in the bodies' axes.
    fn add_joint(&mut self, id: JointId, joint: &Joint);

    /// Removes a joint and wakes its bodies; a joint that went with a body is ignored.
    fn remove_joint(&mut self, id: JointId);

    /// Adds the joints whose load in the last step was above their strength (N, N·m), in the order of ids. They still act:
    /// the scene removes them. An engine that cannot measure loads must not support joints with a strength.
    fn overloaded_joints(&self, out: &mut Vec<JointId>);

    /// Displaces a fixed, dynamic or disabled body and wakes what it touched; a kinematic one moves there in the next
    /// step. Metres, unit quaternion.
    ///
    /// A kinematic body then stands still, unless a velocity is set after the pose.
    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat);

    /// Sets the velocities of a dynamic body, or those that a kinematic one keeps: m/s and rad/s, world frame.
    fn set_velocity(&mut self, id: BodyId, twist: Twist);

    /// Replaces the locomotion of a body. A character is kinematic and has a convex shape; a vehicle is dynamic.
    ///
    /// A character moves by the velocities that are set for it, as far as the world lets it. A step that goes to a pose
    /// is no step of a character: it ends its fall. An engine whose [`Engine::supports`] takes no locomotion gets none, and
    /// none of the calls about it.
    fn set_locomotion(&mut self, id: BodyId, locomotion: &Locomotion) {
        let _ = (id, locomotion);
    }

    /// Sets the speed with which a character rises, m/s.
    fn jump(&mut self, id: BodyId, speed: f32, from: JumpFrom) {
        let _ = (id, speed, from);
    }

    /// Sets the inputs of a vehicle's wheels, one for each.
    fn set_wheels(&mut self, id: BodyId, inputs: &[WheelInput]) {
        let _ = (id, inputs);
    }

    /// Adds the events of the characters that reached or left the ground in the last step, in the order of codes and
    /// then of ids.
    fn ground_events(&self, out: &mut Vec<BodyEvent>) {
        let _ = out;
    }

    /// Puts a dynamic body to sleep, or wakes it. An engine may have what touches it sleep too.
    fn set_activity(&mut self, id: BodyId, activity: Activity);

    /// The change of a body's velocities that a push would bring by the end of the next step if nothing else moved it;
    /// m/s and rad/s, world frame. `None` if the engine cannot say: then the push is not checked. By it a client gets
    /// `OutOfRange` for a push that would make a body faster than a velocity that can be set.
    fn effect(&self, id: BodyId, push: Push) -> Option<Twist> {
        let _ = (id, push);
        None
    }

    /// The change of a body's velocities that the forces and torques since the last step bring, as for
    /// [`Engine::effect`].
    fn pending(&self, id: BodyId) -> Twist {
        let _ = id;
        Twist::ZERO
    }

    /// Pushes a dynamic body, as much as is asked for.
    fn push(&mut self, id: BodyId, push: Push);

    /// Sets gravity, m/s², and wakes all bodies.
    fn set_gravity(&mut self, gravity: Vec3);

    /// Steps once, by the length and substeps of the configuration's integrator, and adds to `lost`, in the order of ids,
    /// the bodies that were removed because they left the world or are not finite any more.
    ///
    /// # Errors
    ///
    /// [`EngineFault`] in the step that failed, and in every later one.
    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault>;

    /// Adds what the last step changed, in the order of ids: each awake body, and once each body that fell asleep or
    /// was static and displaced. Every value is finite and inside the world; a sleeping body does not move until it is
    /// observed awake. Equal after equal steps, to the bit: the publisher predicts from these values.
    fn observe(&self, out: &mut Vec<Observation>);

    /// The present observation of a body, with changes since the last step; fixed ones as asleep.
    fn observe_one(&self, id: BodyId) -> Option<Observation>;

    /// Moments of inertia (kg·m²) of a body that rotates torque-free: dynamic, gyroscopic, with unequal moments. `None`
    /// has its spin predicted as constant, which is right for an engine without gyroscopic forces.
    fn inertia(&self, id: BodyId) -> Option<Inertia>;

    /// Adds one contact for each body that touches this one after the last step: the deepest. Points in metres, forces in
    /// newtons, normals towards this body.
    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>);

    /// False for an engine that knows no contacts: a query for them is refused.
    fn has_contacts(&self) -> bool {
        true
    }

    /// Adds each sensor with a body inside it after the last step, of which this body is one; a pair may come more than
    /// once.
    fn sensed(&self, id: BodyId, out: &mut Vec<(BodyId, BodyId)>);

    /// Answers a query by the poses of the last step. A body that was removed since is not found; one that was added
    /// since may not be found. An engine without queries may search `rhumb_solids::PlacedBodies`.
    ///
    /// # Errors
    ///
    /// [`UnanswerableQuery`] when the engine cannot evaluate it; nothing has changed.
    fn query(&self, query: &Query) -> Result<Answer, UnanswerableQuery>;

    /// Counts, from now on, the pairs of bodies that the next step meets for the first time, until there are
    /// more than `most`.
    fn count_crowding(&mut self, most: u32) {
        let _ = most;
    }

    /// Pairs of bodies whose boxes overlap, which the next step meets for the first time, beyond those that bodies in a heap
    /// have; the last step's too if they are many. Zero for an engine that does not count: then nothing keeps a step from
    /// taking any time.
    fn crowding(&self) -> u64 {
        0
    }

    /// As [`Engine::crowding`], just before a step: with the pairs of the bodies that the step itself puts elsewhere
    /// before it meets anything.
    fn crowding_ahead(&mut self) -> u64 {
        self.crowding()
    }

    /// The pairs that a body would add if it were added now, with this motion.
    fn crowding_with(&self, body: &BodyProperties, motion: &BodyState) -> u64 {
        let _ = (body, motion);
        0
    }

    /// Number of bodies awake after the last step.
    fn awake_count(&self) -> usize;

    /// The fault, if it has stopped stepping.
    fn fault(&self) -> Option<EngineFault>;

    /// A copy that steps on to the same bits. `None` while something has changed since the last step, and for an engine
    /// that cannot be copied: its scenes are not restored after a fault.
    fn copy(&self) -> Option<Box<dyn Engine>> {
        None
    }

    /// A copy of the world as it is, to be encoded on another thread. `None` while something has changed since the last
    /// step that the copy would lack, and for an engine without images: [`EngineKind::keeps_images`] says so, and a data
    /// directory is refused.
    ///
    /// [`EngineKind::keeps_images`]: super::EngineKind::keeps_images
    fn freeze(&self) -> Option<FrozenEngine> {
        None
    }
}

/// Makes a solid of a shape: the same that [`Engine::add_shape`] makes, to the bit.
pub type Baker = fn(&Shape) -> Result<BakedShape, UnusableShape>;

/// A solid of an engine that no world has yet.
#[derive(Debug)]
pub struct BakedShape(Box<dyn Any + Send>);

impl BakedShape {
    /// A solid as its engine knows it.
    pub fn new<Solid: Any + Send>(solid: Solid) -> Self {
        Self(Box::new(solid))
    }

    /// The solid, if it is of this engine.
    #[must_use]
    pub fn into_solid<Solid: Any + Send>(self) -> Option<Solid> {
        self.0.downcast().ok().map(|solid| *solid)
    }
}

/// A copy of an engine's world that becomes bytes when it is called; `None` if the copy cannot be encoded.
pub type FrozenEngine = Box<dyn FnOnce() -> Option<Vec<u8>> + Send>;

/// Error: the engine cannot make a solid of a shape, though its numbers are within the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UnusableShape;

/// Error: the engine has no room for another world in this process. A client that wanted a scene gets `TooManyScenes`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct NoEngine;

impl fmt::Display for NoEngine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the physics engine has no room for another scene in this process")
    }
}

impl core::error::Error for NoEngine {}

/// Error: the engine cannot evaluate a query, though its numbers are within the limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct UnanswerableQuery;

/// Reason why an engine has stopped stepping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum EngineFault {
    /// It panicked; its state cannot be trusted any more.
    Panicked,
    /// So many bodies met within a step that the rest of it might not end.
    Crowded,
}

impl fmt::Display for EngineFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Panicked => f.write_str("the physics engine panicked"),
            Self::Crowded => f.write_str(
                "more bodies overlapped within the step than limits.scene_crowding allows: they must be further apart",
            ),
        }
    }
}

impl core::error::Error for EngineFault {}

/// Mass, principal moments, and their axes: kg, kg·m², principal axes → body.
pub(super) fn mass_of(properties: &BodyProperties, unit: Option<UnitMass>) -> (f32, Vec3, Quat) {
    let own = properties.desc.mass;
    if let Some((mass, moments)) = own.and_then(|own| Some((own.mass, own.moments?))) {
        return (mass, moments, Quat::IDENTITY);
    }
    let Some(unit) = unit else {
        // A body without shape falls too: a kilogram with the moments of a ball of one metre.
        let factor = own.map_or(1.0, |own| own.mass);
        return (factor, Vec3::splat(0.4 * factor), Quat::IDENTITY);
    };
    let density = own.map_or(properties.material.density, |own| own.mass / unit.mass);
    let mass = own.map_or(unit.mass * density, |own| own.mass);
    (mass, unit.moments * density, unit.frame)
}

/// Moments of inertia of a body, if it rotates torque-free with unequal ones.
pub(super) fn inertia(properties: &BodyProperties, unit: Option<UnitMass>) -> Option<Inertia> {
    let desc = &properties.desc;
    if desc.kind != BodyKind::Dynamic || desc.locked != LockedAxes::NONE || !desc.gyroscopic {
        return None;
    }
    let (_, moments, frame) = mass_of(properties, unit);
    let inertia = Inertia::new(moments.to_array(), frame.to_array()).ok()?;
    (!inertia.is_isotropic()).then_some(inertia)
}
