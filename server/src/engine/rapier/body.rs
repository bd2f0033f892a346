//! Conversion of bodies to Rapier and back.
//!
//! Conversion only; `rapier` keeps the list of bodies.

use glam::{DQuat, DVec3, Quat, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    Collider, LockedAxes as RapierLockedAxes, PhysicsWorld, RigidBody, RigidBodyActivation,
    RigidBodyBuilder, RigidBodyHandle, RigidBodyType,
};
use rhumb_protocol::limits::ANGULAR_MAX;
use rhumb_protocol::scene::{BodyKind, Sleep};
use rhumb_reckoning::{BodyId, BodyState, Inertia, InvalidMotion, Pose, Twist};

use crate::engine::interface::{BodyProperties, Push, SPEED_MAX, SPIN_MAX};

/// The body without its solid. A kinematic one's velocities are not Rapier's: see `kinematic_target`.
///
/// `dt`: length of a step, seconds.
pub(super) fn body(properties: &BodyProperties, motion: &BodyState, dt: f32) -> RigidBody {
    let [.., vx, vy, vz, wx, wy, wz] = motion.parts();
    let desc = &properties.desc;
    let mut builder = RigidBodyBuilder::new(body_type(desc.kind))
        .pose(pose_of(motion))
        .user_data(tag(properties));
    if desc.kind == BodyKind::Dynamic {
        builder = builder
            .linvel(Vec3::new(vx, vy, vz))
            .angvel(Vec3::new(wx, wy, wz));
    }
    let mut body = builder.build();
    set_properties(&mut body, properties, dt);
    body
}

/// Rapier's kind of a body.
pub(super) const fn body_type(kind: BodyKind) -> RigidBodyType {
    match kind {
        BodyKind::Fixed => RigidBodyType::Fixed,
        BodyKind::Dynamic => RigidBodyType::Dynamic,
        BodyKind::Kinematic => RigidBodyType::KinematicPositionBased,
    }
}

/// Sets every property of a body but those of its solid. A body that the engine does not move stands still.
///
/// `dt`: length of a step, seconds.
pub(super) fn set_properties(body: &mut RigidBody, properties: &BodyProperties, dt: f32) {
    let desc = &properties.desc;
    let is_dynamic = desc.kind == BodyKind::Dynamic;
    body.set_body_type(body_type(desc.kind), true);
    body.set_linear_damping(properties.damping.linear);
    body.set_angular_damping(properties.damping.angular);
    body.set_gravity_scale(desc.gravity_scale, true);
    body.user_data = tag(properties);
    body.enable_gyroscopic_forces(desc.gyroscopic);
    body.set_allow_fast_rotation(is_dynamic);
    let locked = RapierLockedAxes::from_bits_truncate(desc.locked.bits());
    body.set_locked_axes(locked, true);
    body.set_dominance_group(desc.dominance);
    body.enable_ccd(desc.swept && is_dynamic);
    set_sleep(body, properties.sleep, dt);
    if !is_dynamic || !desc.enabled {
        unpush(body);
        body.set_linvel(Vec3::ZERO, false);
        body.set_angvel(Vec3::ZERO, false);
    }
    body.set_enabled(desc.enabled);
}

/// Leaves the gyroscopic forces of a body whose mass is known to `spin`, unless they are nothing, or its rotation
/// is locked in part.
pub(super) fn take_over_spin(body: &mut RigidBody) {
    if inertia(body).is_some() {
        body.enable_gyroscopic_forces(false);
    }
}

/// True if `spin` turns the spin of a body, as far as its flags say.
pub(super) fn precesses(body: &RigidBody) -> bool {
    body.user_data & GYROSCOPIC != 0 && !body.gyroscopic_forces_enabled()
}

/// Wakes the bodies that a body touched in the last step.
pub(super) fn wake_touching(world: &mut PhysicsWorld, body: RigidBodyHandle) {
    let mut touching = Vec::new();
    for collider in world.bodies[body].colliders() {
        for pair in world.contact_pairs_with(*collider) {
            touching.extend([pair.collider1, pair.collider2]);
        }
    }
    for collider in touching {
        let parent = world.colliders.get(collider).and_then(Collider::parent);
        if let Some(body) = parent.and_then(|handle| world.bodies.get_mut(handle)) {
            body.wake_up(true);
        }
    }
}

/// Lets a body fall asleep by this rule, with the help of `rest`.
fn set_sleep(body: &mut RigidBody, sleep: Sleep, dt: f32) {
    let mut of_rule = RigidBodyActivation::active();
    match sleep {
        Sleep::Settled => {}
        Sleep::Never => of_rule = RigidBodyActivation::cannot_sleep(),
        Sleep::Below(thresholds) => {
            // Rapier compares its threshold with half the speed of the fastest point.
            of_rule.normalized_linear_threshold = thresholds.speed * 0.5;
            of_rule.angular_threshold = thresholds.angular_speed;
            of_rule.time_until_sleep = thresholds.seconds;
        }
    }
    // `rest` needs some steps to see that something moves a body.
    let is_watched = match sleep {
        Sleep::Settled => true,
        Sleep::Never => false,
        Sleep::Below(thresholds) => thresholds.angular_speed < ANGULAR_MAX,
    };
    if is_watched {
        of_rule.time_until_sleep = of_rule.time_until_sleep.max(dt * 4.0);
    }
    let activation = body.activation_mut();
    activation.normalized_linear_threshold = of_rule.normalized_linear_threshold;
    activation.angular_threshold = of_rule.angular_threshold;
    activation.time_until_sleep = of_rule.time_until_sleep;
}

/// An id as Rapier's user data, and above it what Rapier does not know of a body.
fn tag(properties: &BodyProperties) -> u128 {
    let id = properties.desc.id;
    let flag = |is_set: bool, flag| if is_set { flag } else { 0 };
    u128::from(id.generation()) << 32
        | u128::from(id.index())
        | flag(properties.sleep == Sleep::Settled, SETTLED)
        | flag(
            properties.desc.gyroscopic && !locks_rotation(properties),
            GYROSCOPIC,
        )
}

/// Flag of a body that sleeps by the rule `Settled`.
const SETTLED: u128 = 1 << 48;
/// Flag of a body with gyroscopic forces whose rotation is free.
const GYROSCOPIC: u128 = 1 << 49;

fn locks_rotation(properties: &BodyProperties) -> bool {
    (3..6).any(|axis| properties.desc.locked.locks(axis))
}

/// True if a body sleeps by the rule `Settled`.
pub(super) fn sleeps_settled(body: &RigidBody) -> bool {
    body.user_data & SETTLED != 0
}

/// The acceleration by gravity along the axes that are not locked, m/s².
pub(super) fn pull(body: &RigidBody, gravity: Vec3) -> Vec3 {
    let locked = body.locked_axes().bits();
    let free = |axis: u8| f32::from(u8::from(locked & (1 << axis) == 0));
    gravity * body.gravity_scale() * Vec3::new(free(0), free(1), free(2))
}

/// The id of a body that [`body`] made.
pub(super) fn id(body: &RigidBody) -> BodyId {
    BodyId::new(body.user_data as u32, (body.user_data >> 32) as u16)
}

/// A pose whose rotation keeps its exact bits if it is of unit length up to rounding, and is normalised otherwise.
pub(super) fn pose(position: Vec3, rotation: Quat) -> RapierPose {
    let wide = rotation.as_dquat();
    let rounded_only = (wide.length_squared() - 1.0).abs() <= UNIT_ROUNDING;
    let rotation = if rounded_only {
        rotation
    } else {
        wide.normalize().as_quat()
    };
    RapierPose::from_parts(position, rotation)
}

/// The pose of a motion.
pub(super) fn pose_of(motion: &BodyState) -> RapierPose {
    let [px, py, pz, x, y, z, w, ..] = motion.parts();
    pose(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w))
}

/// Rounding error of a unit quaternion of f32: four squares, each rounded by at most 2⁻²⁴ relative, and the sum's
/// error.
const UNIT_ROUNDING: f64 = 1e-6;

/// A pose rounded to the engine's precision.
pub(super) fn narrow(pose: &Pose) -> RapierPose {
    RapierPose::from_parts(pose.position.as_vec3(), pose.rotation.as_quat())
}

/// The pose by the nearer of its two quaternions: to Rapier the way to the other one is an extra turn within one step.
pub(super) fn nearest(pose: RapierPose, to: Quat) -> RapierPose {
    if pose.rotation.dot(to) < 0.0 {
        RapierPose::from_parts(pose.translation, -pose.rotation)
    } else {
        pose
    }
}

/// A pose in f64, its rotation normalised.
pub(super) fn widen(position: Vec3, rotation: Quat) -> Pose {
    let rotation: DQuat = rotation.as_dquat().normalize();
    Pose {
        position: position.as_dvec3(),
        rotation,
    }
}

/// The state of a body, with the velocities of Rapier or the given ones.
///
/// # Errors
///
/// [`InvalidMotion`] for a body that is no longer finite.
pub(super) fn motion(body: &RigidBody, kept: Option<Twist>) -> Result<BodyState, InvalidMotion> {
    let position = body.translation();
    let (linear, angular) = match kept {
        Some(twist) => (twist.linear.as_vec3(), twist.angular.as_vec3()),
        None => (body.linvel(), body.angvel()),
    };
    BodyState::new(
        position.to_array(),
        body.rotation().to_array(),
        linear.to_array(),
        angular.to_array(),
    )
}

/// Moments of inertia of a body, if it rotates torque-free with them.
///
/// A needle or a film so thin that f32 loses one of its moments gets none: it is predicted with a constant spin, and
/// corrected.
pub(super) fn inertia(body: &RigidBody) -> Option<Inertia> {
    if !body.is_dynamic() || body.user_data & GYROSCOPIC == 0 {
        return None;
    }
    let properties = &body.mass_properties().local_mprops;
    let moments = properties.principal_inertia().to_array();
    let frame = properties.principal_inertia_local_frame.to_array();
    let inertia = Inertia::new(moments, frame).ok()?;
    (!inertia.is_isotropic()).then_some(inertia)
}

/// The change of a body's linear and angular velocities that a push brings by the end of the next step; world frame.
///
/// `dt`: length of a step, seconds.
pub(super) fn effect(body: &RigidBody, push: Push, dt: f32) -> (Vec3, Vec3) {
    let properties = body.mass_properties();
    // Zero along locked axes.
    let lightness = properties.effective_inv_mass;
    let turnability = properties.effective_world_inv_inertia;
    let lever = |point: Vec3| point - body.center_of_mass();
    match push {
        Push::ForceAt(force, point) => (
            force * lightness * dt,
            (turnability * lever(point).cross(force)) * dt,
        ),
        Push::ImpulseAt(impulse, point) => (
            impulse * lightness,
            turnability * lever(point).cross(impulse),
        ),
        Push::Force(force) => (force * lightness * dt, Vec3::ZERO),
        Push::Torque(torque) => (Vec3::ZERO, (turnability * torque) * dt),
        Push::Impulse(impulse) => (impulse * lightness, Vec3::ZERO),
        Push::TorqueImpulse(impulse) => (Vec3::ZERO, turnability * impulse),
    }
}

/// The change of a body's velocities by its forces and torques until [`unpush`], as [`effect`] has it.
pub(super) fn pending(body: &RigidBody, dt: f32) -> (Vec3, Vec3) {
    let (linear, _) = effect(body, Push::Force(body.user_force()), dt);
    let (_, angular) = effect(body, Push::Torque(body.user_torque()), dt);
    (linear, angular)
}

/// Pushes a dynamic body. Forces stay until [`unpush`].
pub(super) fn push(body: &mut RigidBody, push: Push) {
    match push {
        Push::Force(force) => body.add_force(force, true),
        Push::Torque(torque) => body.add_torque(torque, true),
        Push::ForceAt(force, point) => {
            let torque = (point - body.center_of_mass()).cross(force);
            body.add_force(force, true);
            body.add_torque(torque, true);
        }
        Push::Impulse(_) | Push::ImpulseAt(..) | Push::TorqueImpulse(_) => {
            let (linear, angular) = effect(body, push, 0.0);
            body.set_linvel(body.linvel() + linear, true);
            body.set_angvel(body.angvel() + angular, true);
        }
    }
}

/// Shortens the forces of a body whose mass has changed since they were checked: an absurd one would make Rapier give
/// up the body and everything it touches.
pub(super) fn bound_forces(body: &mut RigidBody, dt: f32) {
    let (linear, angular) = pending(body, dt);
    let shares = [
        share_within(linear, SPEED_MAX * 2.0),
        share_within(angular, SPIN_MAX * 2.0),
    ];
    if shares != [1.0; 2] {
        let (force, torque) = (body.user_force(), body.user_torque());
        unpush(body);
        body.add_force(force * shares[0], false);
        body.add_torque(torque * shares[1], false);
    }
}

/// Ends all forces and torques.
pub(super) fn unpush(body: &mut RigidBody) {
    body.reset_forces(false);
    body.reset_torques(false);
}

/// The factor in (0, 1] that shortens a vector to `most`, or one if it is shorter. Frame and unit: the vector's.
pub(super) fn share_within(vector: Vec3, most: f32) -> f32 {
    let length = vector.as_dvec3().length();
    if length <= f64::from(most) {
        1.0
    } else {
        (f64::from(most) / length) as f32
    }
}

/// True if a point is inside the world.
pub(super) fn is_within(position: Vec3, most: f32) -> bool {
    position.abs().max_element() <= most
}

/// True if the velocities of a body are finite.
pub(super) fn has_velocities(body: &RigidBody) -> bool {
    body.linvel().is_finite() && body.angvel().is_finite()
}

/// Velocities in the engine's precision.
pub(super) fn narrow_twist(twist: &Twist) -> (Vec3, Vec3) {
    let narrow = |v: DVec3| v.as_vec3();
    (narrow(twist.linear), narrow(twist.angular))
}

/// Velocities in full precision.
pub(super) fn widen_twist((linear, angular): (Vec3, Vec3)) -> Twist {
    Twist {
        linear: linear.as_dvec3(),
        angular: angular.as_dvec3(),
    }
}
