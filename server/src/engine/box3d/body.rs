//! Conversion of bodies to Box3D and back, and their contacts after a step.
//!
//! Conversion only; `box3d` keeps the list of bodies. Box3D reports pairs of shapes, and a contact is one of bodies: of
//! several the deepest counts, and their forces add up. Points that are still apart and bear nothing are no contact.

use glam::{Mat3, Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Contact, Sleep};
use rhumb_reckoning::{BodyId, BodyState, Integrator, InvalidMotion, Pose, Twist};
use rhumb_solids::UnitMass;

use super::native::{Mobility, NativeBody, NativeShape, NewBody, Placement, Touching, World};
use crate::engine::interface::{BodyProperties, Push};
use crate::engine::mass::mass_of;

/// The body without its shapes. A kinematic one's velocities are not Box3D's: see `kinematic_target`.
pub(super) fn new_body(properties: &BodyProperties, motion: &BodyState) -> NewBody {
    let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
    let desc = &properties.desc;
    let is_dynamic = desc.kind == BodyKind::Dynamic;
    let moving = |velocity: Vec3| if is_dynamic { velocity } else { Vec3::ZERO };
    NewBody {
        mobility: mobility(desc.kind),
        at: (Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w)),
        linear: moving(Vec3::new(vx, vy, vz)),
        angular: moving(Vec3::new(wx, wy, wz)),
        tag: tag(desc.id),
    }
}

const fn mobility(kind: BodyKind) -> Mobility {
    match kind {
        BodyKind::Fixed => Mobility::Static,
        BodyKind::Dynamic => Mobility::Dynamic,
        BodyKind::Kinematic => Mobility::Kinematic,
    }
}

/// An id as Box3D's user data: 48 bits.
const fn tag(id: BodyId) -> usize {
    const {
        assert!(size_of::<usize>() == 8, "Box3D's user data holds an id");
    }
    (id.generation() as usize) << 32 | id.index() as usize
}

/// The id of a body by its user data.
pub(super) const fn id(tag: usize) -> BodyId {
    BodyId::new(tag as u32, (tag >> 32) as u16)
}

/// Sets the kind of a body, unless it has it.
pub(super) fn set_kind(world: &mut World, body: NativeBody, kind: BodyKind) {
    world.set_mobility(body, mobility(kind));
}

/// Sets every property of a body but its kind, its shapes and its mass. A body that the engine does not move stands
/// still.
pub(super) fn set_properties(
    world: &mut World,
    body: NativeBody,
    properties: &BodyProperties,
    integrator: Integrator,
) {
    let desc = &properties.desc;
    let is_dynamic = desc.kind == BodyKind::Dynamic;
    let of_substeps = |per_second| damping(per_second, integrator);
    let damping = properties.damping;
    world.set_damping(
        body,
        (of_substeps(damping.linear), of_substeps(damping.angular)),
    );
    world.set_gravity_scale(body, desc.gravity_scale);
    world.set_swept(body, desc.swept && is_dynamic);
    // Box3D has one time for all bodies, and no threshold of the angular speed alone.
    world.set_sleep(
        body,
        match properties.sleep {
            _ if !is_dynamic => Some(None),
            Sleep::Settled => Some(None),
            Sleep::Below(thresholds) => Some(Some(thresholds.speed)),
            Sleep::Never => None,
        },
    );
    world.set_locks(body, [0, 1, 2, 3, 4, 5].map(|axis| desc.locked.locks(axis)));
    if !is_dynamic || !desc.enabled {
        world.set_velocities(body, (Vec3::ZERO, Vec3::ZERO));
    }
    world.set_enabled(body, desc.enabled);
}

/// Substeps of a step. Box3D solves once in each, and with fewer its joints sag by centimetres. Predictors know the scene's
/// number; where it is one, a falling body leaves its prediction by 6 cm in a second at 60 Hz, and is updated.
pub(super) fn substeps(integrator: Integrator) -> u32 {
    integrator.substeps.get().max(4)
}

/// Box3D damps in each substep, the protocol once a tick: the constant with which so many substeps divide a velocity by
/// `1 + dt·damping`.
fn damping(per_second: f32, integrator: Integrator) -> f32 {
    let substeps = f64::from(substeps(integrator));
    let dt = integrator.rate.step().seconds();
    let of_substep = (f64::from(per_second) * dt).ln_1p() / substeps;
    (of_substep.exp_m1() * substeps / dt) as f32
}

/// Gives a body its own mass, or that of its shape.
pub(super) fn weigh(
    world: &mut World,
    body: NativeBody,
    properties: &BodyProperties,
    unit: Option<UnitMass>,
) {
    if properties.desc.kind == BodyKind::Dynamic {
        let (mass, moments, frame) = mass_of(properties, unit);
        let axes = Mat3::from_quat(frame);
        let inertia = axes * Mat3::from_diagonal(moments) * axes.transpose();
        world.set_mass(body, mass, inertia);
    }
}

/// A pose in f64, its rotation normalised.
pub(super) fn widen(position: Vec3, rotation: Quat) -> Pose {
    Pose {
        position: position.as_dvec3(),
        rotation: rotation.as_dquat().normalize(),
    }
}

/// A pose rounded to the engine's precision.
pub(super) fn narrow(pose: &Pose) -> Placement {
    (pose.position.as_vec3(), pose.rotation.as_quat())
}

/// The state of a body, with the velocities of Box3D or the given ones.
///
/// # Errors
///
/// [`InvalidMotion`] for a body that is no longer finite.
pub(super) fn motion(
    world: &World,
    body: NativeBody,
    kept: Option<Twist>,
) -> Result<BodyState, InvalidMotion> {
    let (position, rotation) = world.pose(body);
    let (linear, angular) = match kept {
        Some(twist) => narrow_twist(&twist),
        None => world.velocities(body),
    };
    BodyState::new(
        position.to_array(),
        rotation.to_array(),
        linear.to_array(),
        angular.to_array(),
    )
}

fn narrow_twist(twist: &Twist) -> (Vec3, Vec3) {
    (twist.linear.as_vec3(), twist.angular.as_vec3())
}

/// Sets the velocities of a dynamic body; a change wakes it.
pub(super) fn set_twist(world: &mut World, body: NativeBody, twist: &Twist) {
    let to = narrow_twist(twist);
    if world.velocities(body) != to {
        world.set_awake(body, true);
        world.set_velocities(body, to);
    }
}

/// The change of a body's linear and angular velocities that a push brings by the end of the next step; world frame.
///
/// `dt`: length of a step, seconds.
pub(super) fn effect(world: &World, body: NativeBody, push: Push, dt: f32) -> (Vec3, Vec3) {
    // Zero along locked axes.
    let lightness = world.inverse_mass(body);
    let turnability = world.inverse_inertia(body);
    let (centre, _) = world.pose(body);
    let lever = |point: Vec3| point - centre;
    match push {
        Push::ForceAt(force, point) => (
            force * lightness * dt,
            turnability * lever(point).cross(force) * dt,
        ),
        Push::ImpulseAt(impulse, point) => (
            impulse * lightness,
            turnability * lever(point).cross(impulse),
        ),
        Push::Force(force) => (force * lightness * dt, Vec3::ZERO),
        Push::Torque(torque) => (Vec3::ZERO, turnability * torque * dt),
        Push::Impulse(impulse) => (impulse * lightness, Vec3::ZERO),
        Push::TorqueImpulse(impulse) => (Vec3::ZERO, turnability * impulse),
    }
}

/// Pushes a dynamic body. Box3D ends forces with the step.
pub(super) fn push(world: &mut World, body: NativeBody, push: Push) {
    let (centre, _) = world.pose(body);
    let lever = |point: Vec3| point - centre;
    match push {
        Push::ForceAt(force, point) => {
            let torque = lever(point).cross(force);
            self::push(world, body, Push::Force(force));
            self::push(world, body, Push::Torque(torque));
        }
        Push::ImpulseAt(impulse, point) => {
            let torque_impulse = lever(point).cross(impulse);
            self::push(world, body, Push::Impulse(impulse));
            self::push(world, body, Push::TorqueImpulse(torque_impulse));
        }
        Push::Force(force) if force != Vec3::ZERO => world.push_force(body, force),
        Push::Torque(torque) if torque != Vec3::ZERO => world.push_torque(body, torque),
        Push::Impulse(impulse) if impulse != Vec3::ZERO => world.push_impulse(body, impulse),
        Push::TorqueImpulse(impulse) if impulse != Vec3::ZERO => {
            world.push_torque_impulse(body, impulse);
        }
        Push::Force(_) | Push::Torque(_) | Push::Impulse(_) | Push::TorqueImpulse(_) => {}
    }
}

/// Adds one contact for each body that touches this one, in the order of ids.
///
/// `centre`: the body's centre of mass, world frame. `dt`: length of a step, seconds. `owner`: the body of a shape.
pub(super) fn contacts(
    pairs: &[Touching],
    (of, centre): (BodyId, Vec3),
    dt: f32,
    owner: impl Fn(NativeShape) -> Option<BodyId>,
    out: &mut Vec<Contact>,
) {
    let mut found = Vec::new();
    for pair in pairs {
        let [first, second] = pair.shapes.map(&owner);
        let (Some(first), Some(second)) = (first, second) else {
            continue;
        };
        let [on_first, on_second] = pair.anchors;
        let (with, anchor, normal) = if first == of {
            (second, on_first, -pair.normal)
        } else {
            (first, on_second, pair.normal)
        };
        let contact = Contact {
            with,
            point: centre + anchor,
            normal,
            separation: pair.separation,
            force: pair.impulse / dt,
        };
        let touches = contact.force > 0.0 || contact.separation <= 0.0;
        if touches && is_finite(&contact) {
            found.push(contact);
        }
    }
    found.sort_by(|a, b| (a.with.cmp(&b.with)).then(a.separation.total_cmp(&b.separation)));
    let before = out.len();
    for contact in found {
        match out[before..].last_mut() {
            Some(deepest) if deepest.with == contact.with => deepest.force += contact.force,
            _ => out.push(contact),
        }
    }
}

fn is_finite(contact: &Contact) -> bool {
    let numbers = contact.force.is_finite() && contact.separation.is_finite();
    numbers && contact.point.is_finite() && contact.normal.is_finite()
}
