//! Bodies, shapes and joints of a Box3D world, and contacts after a step.
//!
//! Conversion only; `box3d` keeps the list of bodies. Box3D reports pairs of shapes, and a contact is one of bodies: of
//! several the deepest counts, and their forces add up. Points that are still apart and bear nothing are no contact.

use std::collections::BTreeMap;
use std::f32::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use glam::{DVec3, Mat3, Quat, Vec3};
use rhumb_protocol::scene::{
    BodyKind, Contact, Heights, Joint, JointId, JointKind, JointLimits, JointStrength, Shape, Sleep,
};
use rhumb_reckoning::{BodyId, BodyState, Integrator, InvalidMotion, Pose, Twist};
use rhumb_solids::{SolidPart, UnitMass};

use super::native::{
    HullData, JointShape, MeshData, Mobility, NativeBody, NativeJoint, NativePiece, NativeShape,
    NewBody, Placement, Surface, Touching, World,
};
use crate::engine::interface::{BodyProperties, Push, UnusableShape, mass_of};

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

/// Largest angle of a limit that Box3D allows, radians.
const ANGLE_MAX: f32 = 0.99 * PI;

/// True if Box3D has such a joint: springs, motors, limits of balls and free combinations of axes are not its own.
pub(super) fn supports_joint(joint: &Joint) -> bool {
    joint.motors.iter().all(Option::is_none) && shape(&joint.kind).is_some()
}

/// The joints.
#[derive(Default)]
pub(super) struct Box3dJoints(BTreeMap<JointId, PresentJoint>);

struct PresentJoint {
    joint: NativeJoint,
    strength: Option<JointStrength>,
}

impl Box3dJoints {
    /// Joins two bodies, in place of an earlier joint of the id, and wakes them.
    pub(super) fn add(
        &mut self,
        world: &mut World,
        bodies: [NativeBody; 2],
        (id, joint): (JointId, &Joint),
    ) {
        self.remove(world, id);
        let Some(shape) = shape(&joint.kind) else {
            return;
        };
        // Box3D turns about the frame's z axis, the protocol about its x axis.
        let turn = match shape {
            JointShape::Hinge(_) => Quat::from_rotation_y(FRAC_PI_2),
            _ => Quat::IDENTITY,
        };
        let frames = joint
            .frames
            .map(|frame| (frame.anchor, frame.rotation * turn));
        if let Some(native) = world.join(bodies, frames, (&shape, joint.collide)) {
            let strength = joint.strength;
            let present = PresentJoint {
                joint: native,
                strength,
            };
            self.0.insert(id, present);
        }
    }

    /// Removes a joint, if it is there, and wakes its bodies.
    pub(super) fn remove(&mut self, world: &mut World, id: JointId) {
        if let Some(present) = self.0.remove(&id) {
            world.part(present.joint);
        }
    }

    /// Adds the joints whose load in the last step was above their strength, in the order of ids.
    pub(super) fn overloaded(&self, world: &World, out: &mut Vec<JointId>) {
        let is_overloaded = |(id, present): (&JointId, &PresentJoint)| {
            let strength = present.strength?;
            let (force, torque) = world.load(present.joint)?;
            let is_over = force.length() > strength.force || torque.length() > strength.torque;
            is_over.then_some(*id)
        };
        out.extend(self.0.iter().filter_map(is_overloaded));
    }
}

/// A kind of joint as Box3D has it.
fn shape(kind: &JointKind) -> Option<JointShape> {
    let range = |limits: JointLimits| [limits.least, limits.most];
    Some(match *kind {
        JointKind::Fixed => JointShape::Weld,
        JointKind::Spherical(None) => JointShape::Ball,
        // Box3D measures a hinge within half a turn of its first frame.
        JointKind::Revolute(Some(limits)) if range(limits).iter().any(|at| at.abs() > PI) => {
            return None;
        }
        JointKind::Revolute(limits) => {
            let angles = |limits| range(limits).map(|angle| angle.clamp(-ANGLE_MAX, ANGLE_MAX));
            JointShape::Hinge(limits.map(angles))
        }
        JointKind::Prismatic(limits) => JointShape::Slider(limits.map(range)),
        JointKind::Rope(length) => JointShape::Rope(length),
        JointKind::Spherical(Some(_)) | JointKind::Spring(_) | JointKind::Generic(..) => {
            return None;
        }
    })
}

/// Sides of the hull of a cylinder or a cone.
const SIDES: u16 = 24;

/// Solid that all bodies of one shape share.
pub(super) struct Box3dSolid {
    pub(super) pieces: Vec<NativePiece>,
    /// Mass at density one; `None` for a shape without volume.
    pub(super) unit: Option<UnitMass>,
    /// The same solid for queries.
    pub(super) parts: Vec<SolidPart>,
}

/// True if Box3D has such a shape, and such parts.
pub(super) fn supports_shape(shape: &Shape) -> bool {
    match shape {
        Shape::RoundedCuboid { .. } | Shape::HalfSpace { .. } => false,
        Shape::Compound(compound) => compound
            .parts()
            .iter()
            .all(|part| supports_shape(&part.shape)),
        _ => true,
    }
}

/// The solid of a shape; bodies share it.
///
/// # Errors
///
/// [`UnusableShape`] for a shape without faces, with a hull of too many points, or without normal mass and moments.
pub(super) fn solid(shape: &Shape) -> Result<Box3dSolid, UnusableShape> {
    let mut pieces = Vec::new();
    add_pieces(shape, (Vec3::ZERO, Quat::IDENTITY), &mut pieces)?;
    let parts = rhumb_solids::parts(shape).ok_or(UnusableShape)?;
    let has_volume = shape.is_solid() && !parts.is_empty();
    let unit = UnitMass::of(&parts).filter(|_| has_volume);
    if has_volume && unit.is_none() {
        return Err(UnusableShape);
    }
    Ok(Box3dSolid {
        pieces,
        unit,
        parts,
    })
}

/// Adds the pieces of a shape at a pose of its body.
fn add_pieces(
    shape: &Shape,
    (centre, turn): Placement,
    pieces: &mut Vec<NativePiece>,
) -> Result<(), UnusableShape> {
    let place = |point: Vec3| centre + turn * point;
    let hull = |points: &mut dyn Iterator<Item = Vec3>| {
        let points: Vec<_> = points.map(place).collect();
        let hull = HullData::new(&points).ok_or(UnusableShape)?;
        Ok(NativePiece::Hull(Arc::new(hull)))
    };
    let piece = match shape {
        Shape::Ball { radius } => NativePiece::Sphere(centre, *radius),
        Shape::Capsule {
            half_height,
            radius,
        } => {
            let end = Vec3::Y * *half_height;
            NativePiece::Capsule([place(-end), place(end)], *radius)
        }
        Shape::Cuboid { half_extents } => NativePiece::Cuboid(*half_extents, (centre, turn)),
        Shape::Cylinder {
            half_height: h,
            radius,
        } => hull(&mut ring(*radius, -h).chain(ring(*radius, *h)))?,
        Shape::Cone {
            half_height: h,
            radius,
        } => {
            let tip = Vec3::new(0.0, h * 1.5, 0.0);
            hull(&mut ring(*radius, -h * 0.5).chain([tip]))?
        }
        Shape::Hull(of) => hull(&mut of.points().iter().copied())?,
        Shape::Heights(heights) => {
            let (points, triangles) = ground(heights);
            mesh(points.into_iter().map(place), &triangles)?
        }
        Shape::Mesh(of) => mesh(of.points().iter().copied().map(place), of.triangles())?,
        Shape::Compound(compound) => {
            for part in compound.parts() {
                let at = (place(part.position), turn * part.rotation);
                add_pieces(&part.shape, at, pieces)?;
            }
            return Ok(());
        }
        Shape::RoundedCuboid { .. } | Shape::HalfSpace { .. } => return Err(UnusableShape),
    };
    pieces.push(piece);
    Ok(())
}

/// Points on a circle around the y axis.
fn ring(radius: f32, height: f32) -> impl Iterator<Item = Vec3> {
    (0..SIDES).map(move |side| {
        let angle = f32::from(side) / f32::from(SIDES) * core::f32::consts::TAU;
        Quat::from_rotation_y(angle) * Vec3::new(radius, height, 0.0)
    })
}

fn mesh(
    points: impl Iterator<Item = Vec3>,
    triangles: &[[u32; 3]],
) -> Result<NativePiece, UnusableShape> {
    let points: Vec<_> = points.collect();
    let mesh = MeshData::new(&points, triangles).ok_or(UnusableShape)?;
    Ok(NativePiece::Mesh(Arc::new(mesh)))
}

/// The posts of a height field and two triangles for each cell, whose fronts are up.
fn ground(heights: &Heights) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let points = heights.posts().map(DVec3::as_vec3).collect();
    let (rows, columns) = (heights.rows(), heights.columns());
    let mut triangles = Vec::new();
    for row in 0..rows - 1 {
        for column in 0..columns - 1 {
            let near = row * columns + column;
            let far = near + columns;
            triangles.push([near, near + 1, far]);
            triangles.push([far, near + 1, far + 1]);
        }
    }
    (points, triangles)
}

/// The surface and the filter of a body's shapes.
pub(super) const fn surface(properties: &BodyProperties) -> Surface {
    let (desc, material) = (&properties.desc, properties.material);
    Surface {
        friction: material.friction,
        restitution: material.restitution,
        members: desc.groups.members,
        touches: desc.groups.touches,
        is_sensor: desc.sensor,
    }
}
