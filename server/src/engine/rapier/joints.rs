//! Joints of a Rapier world, and motors that accelerate as PROTOCOL says.
//!
//! Rapier weighs a motor by two bodies that nothing holds. A hinge off the centre of mass makes it too weak by the share of
//! the lever in the moment of inertia, and so does what hangs on the second body. So a motor is a joint of its own here,
//! beside the one that holds the bodies. Before each step it is laid along the line on which a push leaves the other axes of
//! the joint in peace, and gets the stiffness and damping that give the acceleration at the whole mass that it moves.
//!
//! Where no such line is and the mass is great, an engine that solves twice in a substep cannot reach a stiff motor's
//! acceleration. Then the motor is slower, and keeps its damping ratio.
//!
//! Impulse joints only. Rapier removes a joint with either of its bodies, so some handles may be stale.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DVec3, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    GenericJoint, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    PhysicsWorld, RigidBodyHandle,
};
use rhumb_protocol::scene::{Joint, JointFrame, JointId, JointKind, JointStrength, Motor};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};

use super::body::pose;
use super::drives::{DrivenMotion, Gains, after_step, drives, gains, mean_acceleration};
use super::held_joint::{Ease, HeldJoint, Six};

/// The joints.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierJoints {
    handles: BTreeMap<JointId, ImpulseJointHandle>,
    /// The joints that can break.
    strengths: BTreeMap<JointId, JointStrength>,
    /// By the parts of a handle.
    motors: BTreeMap<(u32, u32), JointMotors>,
}

impl RapierJoints {
    /// Joins two bodies, in place of an earlier joint of the id.
    pub(super) fn add(
        &mut self,
        world: &mut PhysicsWorld,
        bodies: [RigidBodyHandle; 2],
        (id, joint): (JointId, &Joint),
    ) {
        self.remove(world, id);
        let [first, second] = bodies;
        // Motors are solved first, so that the joint has the last word.
        let motors = JointMotors::add(world, bodies, joint);
        let handle = world.insert_impulse_joint(first, second, generic(joint));
        self.handles.insert(id, handle);
        if let Some(motors) = motors {
            self.motors.insert(handle.into_raw_parts(), motors);
        }
        if let Some(strength) = joint.strength {
            self.strengths.insert(id, strength);
        }
    }

    /// Removes a joint, if it is there.
    pub(super) fn remove(&mut self, world: &mut PhysicsWorld, id: JointId) {
        self.strengths.remove(&id);
        if let Some(handle) = self.handles.remove(&id) {
            world.remove_impulse_joint(handle);
            if let Some(motors) = self.motors.remove(&handle.into_raw_parts()) {
                motors.remove(world);
            }
        }
    }

    /// Lays the motors anew for the next step.
    pub(super) fn aim(&mut self, world: &mut PhysicsWorld) {
        // A body takes its joints with it.
        let holds = |(index, generation): &(u32, u32)| {
            let handle = ImpulseJointHandle::from_raw_parts(*index, *generation);
            world.impulse_joints.get(handle).is_some()
        };
        self.motors.retain(|handle, _| holds(handle));
        if !self.motors.is_empty() {
            aim(world, &mut self.motors);
        }
    }

    /// Adds the joints whose load in the last step was above their strength.
    ///
    /// `substep`: seconds in which a joint's impulses act.
    pub(super) fn overloaded(&self, world: &PhysicsWorld, substep: f32, out: &mut Vec<JointId>) {
        let is_overloaded = |(id, strength): (&JointId, &JointStrength)| {
            let handle = *self.handles.get(id)?;
            let joint = world.impulse_joints.get(handle)?;
            let motors = self.motors.get(&handle.into_raw_parts());
            let pushed = motors.map_or([0.0; 6], |motors| motors.impulses(world));
            let own = joint.impulses;
            let [x, y, z, about_x, about_y, about_z] =
                [0, 1, 2, 3, 4, 5].map(|axis| own[axis] + pushed[axis]);
            let force = Vec3::new(x, y, z).length() / substep;
            let torque = Vec3::new(about_x, about_y, about_z).length() / substep;
            (force > strength.force || torque > strength.torque).then_some(*id)
        };
        out.extend(self.strengths.iter().filter_map(is_overloaded));
    }

    /// Forgets all joints of a world that is gone.
    pub(super) fn clear(&mut self) {
        self.handles.clear();
        self.strengths.clear();
        self.motors.clear();
    }
}

impl Wire for RapierJoints {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.handles.len() as u64);
        for (id, handle) in &self.handles {
            id.encode(to);
            let (index, generation) = handle.into_raw_parts();
            to.varint(u64::from(index));
            to.varint(u64::from(generation));
        }
        to.varint(self.strengths.len() as u64);
        for (id, strength) in &self.strengths {
            id.encode(to);
            to.f32s(&[strength.force, strength.torque]);
        }
        to.varint(self.motors.len() as u64);
        for ((index, generation), motors) in &self.motors {
            to.varint(u64::from(*index));
            to.varint(u64::from(*generation));
            motors.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut joints = Self::default();
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let (index, generation) = (from.varint32()?, from.varint32()?);
            let handle = ImpulseJointHandle::from_raw_parts(index, generation);
            joints.handles.insert(id, handle);
        }
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let [force, torque] = from.f32s()?;
            joints.strengths.insert(id, JointStrength { force, torque });
        }
        for _ in 0..from.varint()? {
            let handle = (from.varint32()?, from.varint32()?);
            joints.motors.insert(handle, JointMotors::decode(from)?);
        }
        Ok(joints)
    }
}

/// The axes in the order of the protocol.
const AXES: [JointAxis; 6] = [
    JointAxis::LinX,
    JointAxis::LinY,
    JointAxis::LinZ,
    JointAxis::AngX,
    JointAxis::AngY,
    JointAxis::AngZ,
];

fn generic(joint: &Joint) -> GenericJoint {
    let [first, second] = joint
        .frames
        .map(|JointFrame { anchor, rotation }| pose(anchor, rotation));
    let locked = JointAxesMask::from_bits_truncate(joint.kind.locked().bits());
    let mut builder = GenericJointBuilder::new(locked)
        .local_frame1(first)
        .local_frame2(second)
        .contacts_enabled(joint.collide);
    match joint.kind {
        JointKind::Rope(length) => {
            builder = builder
                .coupled_axes(JointAxesMask::LIN_AXES)
                .limits(JointAxis::LinX, [0.0, length]);
        }
        JointKind::Spring(spring) => {
            builder = builder
                .coupled_axes(JointAxesMask::LIN_AXES)
                .motor_position(
                    JointAxis::LinX,
                    spring.length,
                    spring.stiffness,
                    spring.damping,
                )
                .motor_model(JointAxis::LinX, MotorModel::ForceBased);
        }
        _ => {}
    }
    for (axis, limits) in AXES.into_iter().zip(joint.kind.limits()) {
        if let Some(limits) = limits {
            builder = builder.limits(axis, [limits.least, limits.most]);
        }
    }
    builder.build()
}

/// The motors of one joint.
#[derive(Clone, Debug)]
pub(super) struct JointMotors {
    /// By axis: translations along x, y and z of the first frame, then rotations about them.
    motors: Vec<(u8, Motor, ImpulseJointHandle)>,
    collide: bool,
    /// Pushes of the motors in the last step, for the load of the joint.
    pushes: Vec<MotorPush>,
}

/// The push of a motor: force and torque at the anchor for each unit of its impulse, along the axes of the joint.
#[derive(Clone, Copy, Debug, Default)]
struct MotorPush {
    motor: usize,
    along: [f32; 6],
}

/// Most that a motor along a line turns in a step, radians.
const LINE_TURN_MAX: f64 = 1.0;

/// Most that what a motor moves may weigh, in weights of its two bodies, for the motor to be coupled with others. Beyond that
/// the solver is too far from the whole motion.
const COUPLED_MAX: f64 = 10.0;

/// Farthest target of a motor about a line, radians.
const ANGLE_MAX: f64 = 2.0;

/// Metres that no line reaches in a step.
const FAR: f64 = 1e9;

/// A row along a line is chosen where a plain torque would lose more than this share to the other axes.
const LOSS: f64 = 1e-3;

impl JointMotors {
    /// Adds the joints of the motors; `None` for a joint without motors. They act after [`aim`].
    pub(super) fn add(
        world: &mut PhysicsWorld,
        [first, second]: [RigidBodyHandle; 2],
        joint: &Joint,
    ) -> Option<Self> {
        let mut motors = Vec::new();
        for (axis, motor) in (0..).zip(&joint.motors) {
            if let Some(motor) = motor {
                let idle = GenericJointBuilder::new(JointAxesMask::empty())
                    .contacts_enabled(joint.collide)
                    .build();
                let handle = world.insert_impulse_joint(first, second, idle);
                motors.push((axis, *motor, handle));
            }
        }
        (!motors.is_empty()).then(|| Self {
            motors,
            collide: joint.collide,
            pushes: Vec::new(),
        })
    }

    /// Removes the joints of the motors.
    pub(super) fn remove(self, world: &mut PhysicsWorld) {
        for (_, _, handle) in self.motors {
            world.remove_impulse_joint(handle);
        }
    }

    /// Impulses of the motors of the last substep on the axes of the joint.
    pub(super) fn impulses(&self, world: &PhysicsWorld) -> [f32; 6] {
        let mut sum = [0.0; 6];
        for push in &self.pushes {
            let (_, _, handle) = self.motors[push.motor];
            let Some(joint) = world.impulse_joints.get(handle) else {
                continue;
            };
            let motors = joint.data.motors.iter();
            let limits = joint.data.limits.iter().map(|limit| limit.impulse);
            let impulse: f32 = motors.map(|motor| motor.impulse).chain(limits).sum();
            for (sum, along) in sum.iter_mut().zip(push.along) {
                *sum += along * impulse;
            }
        }
        sum
    }

    /// True if no axis of a joint with these locked axes moves without one of the motors.
    fn hold(&self, locked: JointAxesMask) -> bool {
        let moved = self.motors.iter().filter(|(_, motor, _)| {
            motor.force > 0.0 && (motor.stiffness > 0.0 || motor.damping > 0.0)
        });
        let moved = moved.fold(0, |axes, (axis, ..)| axes | 1 << axis);
        locked.bits() | moved == JointAxesMask::all().bits()
    }
}

/// Lays all motors anew for the next step. `motors`: by the handle of the joint that holds the bodies.
pub(super) fn aim(world: &mut PhysicsWorld, motors: &mut BTreeMap<(u32, u32), JointMotors>) {
    let parameters = &world.integration_parameters;
    let substep = f64::from(parameters.dt) / parameters.num_solver_iterations as f64;
    let holding: BTreeSet<_> = motors
        .iter()
        .filter(|(handle, motors)| {
            let joint = world.impulse_joints.get(of_parts(**handle));
            joint.is_some_and(|joint| motors.hold(joint.data.locked_axes))
        })
        .map(|(handle, _)| *handle)
        .collect();
    let (mut joints, mut rows) = (Vec::new(), Vec::new());
    for (handle, motors) in motors.iter_mut() {
        let joint = of_parts(*handle);
        let Some(held) = HeldJoint::of(world, joint, &holding) else {
            continue;
        };
        motors.pushes.clear();
        let settings: Vec<_> = motors
            .motors
            .iter()
            .map(|(axis, motor, _)| (usize::from(*axis), *motor))
            .collect();
        let drives = drives(&held, &settings, substep);
        for (place, (drive, (_, _, own))) in drives.into_iter().zip(&motors.motors).enumerate() {
            let row = held.row(&drive);
            motors.pushes.push(MotorPush {
                motor: place,
                along: held.along(&row),
            });
            let (motor, times) = (&drive.motor, (held.step, substep));
            let mean = mean_acceleration(motor, drive.lack, drive.rate, times) + drive.more;
            let is_exact = row.ease[0] <= COUPLED_MAX * row.ease[1]
                && gains(row.ease, motor, substep).is_exact
                && holding.contains(handle)
                && settings.len() == 1;
            let moved = is_exact.then(|| held.moved(world, &drive));
            rows.push(MotorRow {
                joint: joints.len(),
                drive,
                own: *own,
                row,
                mean,
                moved: moved.flatten(),
            });
        }
        joints.push((held, motors.collide));
    }
    let coupled = coupled(&rows);
    for (row, coupled) in rows.iter().zip(coupled) {
        let (held, collide) = &joints[row.joint];
        let joint = held.motor(row, coupled, (substep, *collide));
        if let Some(own) = world.impulse_joints.get_mut(row.own, false) {
            let impulses = own.data.motors.map(|motor| motor.impulse);
            own.data = joint;
            for (motor, impulse) in own.data.motors.iter_mut().zip(impulses) {
                motor.impulse = impulse;
            }
        }
    }
}

/// A motor of a step.
struct MotorRow {
    /// Place of its joint.
    joint: usize,
    drive: DrivenMotion,
    own: ImpulseJointHandle,
    row: Row,
    /// Mean acceleration of the step by its law.
    mean: f64,
    /// The bodies that it moves against a base that stands still; `None` where there is none.
    moved: Option<Vec<MovedBody>>,
}

/// A body that a motor moves, with what is held together.
struct MovedBody {
    body: RigidBodyHandle,
    mass: f64,
    inertia: DMat3,
    /// Velocities of its centre for each unit of the motor's.
    motion: Six,
}

/// The force or torque of each motor that the others' accelerations need of it: in a chain, each link carries the next.
fn coupled(rows: &[MotorRow]) -> Vec<f64> {
    let weight = |one: &[MovedBody], other: &[MovedBody]| {
        let mut weight = 0.0;
        for body in one {
            let same = other.iter().find(|moved| moved.body == body.body);
            if let Some(same) = same {
                let turned = body.inertia * same.motion.angular;
                weight += body.mass * body.motion.linear.dot(same.motion.linear);
                weight += body.motion.angular.dot(turned);
            }
        }
        weight
    };
    // A motor at its greatest force accelerates less than its law.
    let means = rows.iter().map(|row| match &row.moved {
        Some(moved) => {
            let most =
                f64::from(row.drive.motor.force) / weight(moved, moved).max(f64::MIN_POSITIVE);
            row.mean.clamp(-most, most)
        }
        None => 0.0,
    });
    let means: Vec<_> = means.collect();
    let needed = rows.iter().map(|row| {
        let Some(moved) = &row.moved else { return 0.0 };
        let others = rows.iter().zip(&means);
        let others = others.filter(|(other, mean)| other.joint != row.joint && **mean != 0.0);
        let shares = others.map(|(other, mean)| {
            other
                .moved
                .as_ref()
                .map_or(0.0, |other| weight(moved, other) * mean)
        });
        shares.sum()
    });
    needed.collect()
}

fn of_parts((index, generation): (u32, u32)) -> ImpulseJointHandle {
    ImpulseJointHandle::from_raw_parts(index, generation)
}

/// A motor's line in the world.
#[derive(Clone, Copy, Debug)]
enum Line {
    /// A force along a direction at a point.
    Force(DVec3, DVec3),
    /// A torque about a direction.
    Torque(DVec3),
}

/// The row of a motor: a line, and what it weighs.
#[derive(Clone, Copy, Debug)]
struct Row {
    line: Line,
    /// Force and torque at the anchor for each unit of its impulse.
    push: Six,
    /// Its velocity for each unit of the motor's.
    scale: f64,
    /// True for the motor of a rotation.
    turns: bool,
    /// Its velocity for each unit of impulse before the joint answers, and when all that is held together moves.
    ease: [f64; 2],
}

impl HeldJoint {
    /// The best row for a motor whose push at the anchor this is.
    fn row(&self, drive: &DrivenMotion) -> Row {
        let unit = drive.unit;
        let (push, answer) = self.freed(&self.pair, unit);
        let ease = answer.dot(unit).max(f64::MIN_POSITIVE);
        // Velocities for each unit of the motor's, with the locked axes at rest.
        let motion = Six {
            linear: answer.linear / ease,
            angular: answer.angular / ease,
        };
        let whole = self.held.map_or(ease, |held| {
            let (_, answer) = self.freed(&held, unit);
            answer.dot(unit).clamp(0.0, ease)
        });
        let row = |line: Line| {
            let push = match line {
                Line::Force(direction, point) => Six {
                    linear: direction,
                    angular: (point - self.anchor).cross(direction),
                },
                Line::Torque(direction) => Six {
                    linear: DVec3::ZERO,
                    angular: direction,
                },
            };
            let scale = push.dot(motion);
            let own = self.answer(&self.pair, push).dot(push);
            Row {
                line,
                push,
                scale,
                turns: unit.linear == DVec3::ZERO,
                ease: [own, (scale * scale * whole).min(own)],
            }
        };
        let plain = row(match unit.linear == DVec3::ZERO {
            true => Line::Torque(unit.angular),
            false => {
                let offset = unit.linear.cross(unit.angular);
                Line::Force(unit.linear, self.anchor + offset)
            }
        });
        let loss = |row: &Row| 1.0 - row.scale * row.scale * ease / row.ease[0];
        let (mut along, mut about) = (push.linear, push.angular);
        if drive.is_laid && drive.is_turn {
            // Nothing about the axes of the other motors.
            along -= unit.angular * along.dot(unit.angular);
            about = unit.angular * about.dot(unit.angular);
        }
        let force = along.length();
        if force <= f64::MIN_POSITIVE || loss(&plain) <= LOSS {
            return plain;
        }
        let direction = along / force;
        let offset = direction.cross(about) / force;
        let line = row(Line::Force(direction, self.anchor + offset));
        let is_usable = offset.is_finite() && line.scale > 0.0;
        if is_usable && loss(&line) < loss(&plain) {
            line
        } else {
            plain
        }
    }

    /// The push of a row on the axes that the joint locks.
    fn along(&self, row: &Row) -> [f32; 6] {
        [0, 1, 2, 3, 4, 5].map(|axis| match self.locked[axis] {
            true => self.axis(axis).dot(row.push) as f32,
            false => 0.0,
        })
    }

    /// The bodies that the motor of an axis moves, if the other side holds to something that stands still.
    fn moved(&self, world: &PhysicsWorld, drive: &DrivenMotion) -> Option<Vec<MovedBody>> {
        let is_still = |side: &Vec<RigidBodyHandle>| {
            let mut bodies = side.iter().filter_map(|handle| world.bodies.get(*handle));
            bodies.any(|body| !body.is_dynamic())
        };
        let [first, second] = self.sides.as_ref()?;
        let (side, sign) = match (is_still(first), is_still(second)) {
            (true, false) => (second, 1.0),
            (false, true) => (first, -1.0),
            _ => return None,
        };
        let direction = drive.direction() * sign;
        let moved = side.iter().map(|handle| {
            let ease = Ease::of(world.bodies.get(*handle)?);
            let motion = match drive.is_turn {
                false => Six {
                    linear: direction,
                    angular: DVec3::ZERO,
                },
                true => Six {
                    linear: direction.cross(ease.centre - drive.centre),
                    angular: direction,
                },
            };
            ease.is_free().then(|| MovedBody {
                body: *handle,
                mass: 1.0 / ease.linear.x,
                inertia: ease.angular.inverse(),
                motion,
            })
        });
        moved.collect()
    }

    /// Lack of position and velocity of a motor for the line of its row. A turn that is driven along a straight line covers
    /// less of the line the farther it goes in a step.
    fn straightened(&self, row: &MotorRow, substep: f64) -> [f64; 2] {
        let DrivenMotion {
            motor, lack, rate, ..
        } = &row.drive;
        let (lack, speed) = (*lack, f64::from(motor.velocity));
        if !row.drive.is_turn || matches!(row.row.line, Line::Torque(_)) {
            return [lack, speed];
        }
        let (turn, _) = after_step(motor, lack, *rate, (self.step, substep));
        let turn = turn.clamp(-LINE_TURN_MAX, LINE_TURN_MAX);
        let (sine, cosine) = (libm::sin(turn), libm::cos(turn));
        let rest = match turn.abs() < LINE_TURN_MAX {
            true => (lack - turn) * cosine,
            false => 0.0,
        };
        let mean = if turn == 0.0 { 1.0 } else { sine / turn };
        [sine + rest, speed * mean]
    }

    /// The limits of a motor along or about the line of its row, from where it is.
    fn limited(&self, limits: [f64; 2], row: &Row) -> [f32; 2] {
        let is_straight = matches!(row.line, Line::Torque(_));
        limits.map(|limit| match row.turns && !is_straight {
            true if limit.abs() < LINE_TURN_MAX => (libm::sin(limit) * row.scale) as f32,
            true => (limit.signum() * FAR) as f32,
            false => (limit * row.scale) as f32,
        })
    }

    /// The joint of a motor for the next step. `coupled`: force or torque beside that of its law.
    fn motor(
        &self,
        of_row: &MotorRow,
        coupled: f64,
        (substep, collide): (f64, bool),
    ) -> GenericJoint {
        let (row, drive) = (&of_row.row, &of_row.drive);
        let motor = &drive.motor;
        let [lack, speed] = self.straightened(of_row, substep);
        let Gains {
            stiffness,
            damping,
            share,
            ..
        } = gains(row.ease, motor, substep);
        // A velocity that the motor lacks gives it this force more.
        let whole = row.ease[1] / (row.scale * row.scale);
        let coupled = coupled + drive.more / whole.max(f64::MIN_POSITIVE);
        let more = match share > 0.0 {
            true => coupled / row.scale * substep / share,
            false => 0.0,
        };
        // Of a motor that holds a position as a lack of position, so that its velocity stays what was asked for.
        let (more_lack, more_speed) = match stiffness > 0.0 {
            true => (more * (substep * stiffness + damping) / stiffness, 0.0),
            false => (0.0, more),
        };
        let (lack, speed) = (lack * row.scale + more_lack, speed * row.scale + more_speed);
        // The engine takes an angle the short way round; what is far is driven as a velocity that gives the same.
        let near = match row.line {
            Line::Force(..) => lack,
            Line::Torque(_) => lack.clamp(-ANGLE_MAX, ANGLE_MAX),
        };
        let softened = substep * stiffness + damping;
        let far = (lack - near) * stiffness / softened.max(f64::MIN_POSITIVE);
        let (at, direction, driven) = match row.line {
            Line::Force(direction, point) => (point, direction, JointAxis::LinX),
            Line::Torque(direction) => (self.anchor, direction, JointAxis::AngX),
        };
        let turn = glam::Quat::from_rotation_arc(Vec3::X, direction.as_vec3());
        let there = RapierPose::from_parts(at.as_vec3(), turn.normalize());
        let [first, second] = self.poses.map(|pose| pose.inverse() * there);
        let joint = GenericJointBuilder::new(JointAxesMask::empty())
            .contacts_enabled(collide)
            .local_frame1(first)
            .local_frame2(second)
            .motor_model(driven, MotorModel::ForceBased)
            .set_motor(
                driven,
                near as f32,
                (speed + far) as f32,
                stiffness as f32,
                damping as f32,
            )
            .motor_max_force(driven, (f64::from(motor.force) / row.scale) as f32);
        // The engine solves the joints of two bodies in any order, but a joint's limits after its own motor.
        match drive.limits {
            Some(limits) => joint.limits(driven, self.limited(limits, row)).build(),
            None => joint.build(),
        }
    }
}

impl Wire for JointMotors {
    fn encode(&self, to: &mut Writer) {
        to.u8(u8::from(self.collide));
        to.u8(self.motors.len() as u8);
        for (axis, motor, handle) in &self.motors {
            to.u8(*axis);
            motor.encode(to);
            let (index, generation) = handle.into_raw_parts();
            to.varint(u64::from(index));
            to.varint(u64::from(generation));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let collide = from.u8()? != 0;
        let mut motors = Vec::new();
        for _ in 0..from.u8()? {
            let (axis, motor) = (from.u8()?, Motor::decode(from)?);
            let (index, generation) = (from.varint32()?, from.varint32()?);
            motors.push((axis, motor, of_parts((index, generation))));
        }
        Ok(Self {
            motors,
            collide,
            pushes: Vec::new(),
        })
    }
}
