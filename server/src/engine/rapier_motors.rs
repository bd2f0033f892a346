//! Motors of a Rapier world's joints, which accelerate as the protocol says.
//!
//! Rapier weighs a motor by two bodies that nothing holds. A hinge off the centre of mass makes it too weak by the share of
//! the lever in the moment of inertia, and so does what hangs on the second body. So a motor is a joint of its own here,
//! beside the one that holds the bodies. Before each step it is laid along the line on which a push leaves the other axes of
//! the joint in peace, and gets the stiffness and damping that give the acceleration at the whole mass that it moves.
//!
//! Where no such line is and the mass is great, an engine that solves twice in a substep cannot reach a stiff motor's
//! acceleration. Then the motor is slower, and keeps its damping ratio.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DVec3, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    GenericJoint, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    PhysicsWorld, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::{Joint, Motor};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};

use super::rapier_ease::{Ease, Six, held_together, side};

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
            let impulse: f32 = motors.map(|motor| motor.impulse).sum();
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
        for (place, (axis, motor, own)) in motors.motors.iter().enumerate() {
            let (axis, row) = (usize::from(*axis), held.row(usize::from(*axis)));
            motors.pushes.push(MotorPush {
                motor: place,
                along: held.along(&row),
            });
            let lack = held.lack(axis, motor);
            let mean = mean_acceleration(motor, lack, held.rates[axis], (held.step, substep));
            let is_exact = row.ease[0] <= COUPLED_MAX * row.ease[1]
                && gains(&row, motor, substep).is_exact
                && holding.contains(handle);
            let moved = is_exact.then(|| held.moved(world, axis));
            rows.push(MotorRow {
                joint: joints.len(),
                axis,
                motor: *motor,
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
    axis: usize,
    motor: Motor,
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
            let most = f64::from(row.motor.force) / weight(moved, moved).max(f64::MIN_POSITIVE);
            row.mean.clamp(-most, most)
        }
        None => 0.0,
    });
    let means: Vec<_> = means.collect();
    let needed = rows.iter().enumerate().map(|(place, row)| {
        let Some(moved) = &row.moved else { return 0.0 };
        let others = rows.iter().zip(&means).enumerate();
        let others = others.filter(|(other, (_, mean))| *other != place && **mean != 0.0);
        let shares = others.map(|(_, (other, mean))| {
            other
                .moved
                .as_ref()
                .map_or(0.0, |other| weight(moved, other) * mean)
        });
        shares.sum()
    });
    needed.collect()
}

/// The mean acceleration of a motor in a step, by its law and as the solver takes it: in substeps, each by its end.
fn mean_acceleration(motor: &Motor, lack: f64, rate: f64, (step, substep): (f64, f64)) -> f64 {
    let (turned, rate_after) = after_step(motor, lack, rate, (step, substep));
    debug_assert!(turned.is_finite(), "its numbers are");
    (rate_after - rate) / step
}

/// The way and the rate of a motor after a step, by its law.
fn after_step(motor: &Motor, lack: f64, rate: f64, (step, substep): (f64, f64)) -> (f64, f64) {
    let (stiffness, damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let (mut way, mut now) = (0.0, rate);
    let mut left = step;
    while left > substep * 0.5 {
        let slow = f64::from(motor.velocity) - now;
        let force = stiffness * (lack - way - substep * now) + damping * slow;
        now += substep * force / (1.0 + substep * damping + substep * substep * stiffness);
        way += substep * now;
        left -= substep;
    }
    (way, now)
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
    /// Its velocity for each unit of impulse before the joint answers, and when all that is held together moves.
    ease: [f64; 2],
}

/// A joint as it is before a step.
struct HeldJoint {
    poses: [RapierPose; 2],
    anchor: DVec3,
    /// Directions of the axes: those of the first frame.
    axes: DMat3,
    locked: [bool; 6],
    /// Place of the second frame in the first, by axis: metres, radians.
    place: [f64; 6],
    /// Relative velocity along and about the axes, m/s and rad/s.
    rates: [f64; 6],
    /// Length of a step, seconds.
    step: f64,
    pair: [Ease; 2],
    /// The bodies that are held together with either; `None` if they are the same.
    sides: Option<[Vec<RigidBodyHandle>; 2]>,
    held: Option<[Ease; 2]>,
}

impl HeldJoint {
    /// `None` for a joint whose bodies are not there or do not move.
    fn of(
        world: &PhysicsWorld,
        handle: ImpulseJointHandle,
        holding: &BTreeSet<(u32, u32)>,
    ) -> Option<Self> {
        let joint = world.impulse_joints.get(handle)?;
        let handles = [joint.body1(), joint.body2()];
        let [first, second] = handles.map(|body| world.bodies.get(body));
        let bodies = [first?, second?];
        let is_awake = |body: &&RigidBody| body.is_dynamic() && !body.is_sleeping();
        if !bodies.iter().all(|body| body.is_enabled()) || !bodies.iter().any(is_awake) {
            return None;
        }
        let poses = bodies.map(|body| *body.position());
        let frames = [
            poses[0] * joint.data.local_frame1,
            poses[1] * joint.data.local_frame2,
        ];
        let rotation = frames[0].rotation.as_dquat();
        let axes = DMat3::from_quat(rotation);
        let apart = (frames[1].translation - frames[0].translation).as_dvec3();
        let mut turn = rotation.inverse() * frames[1].rotation.as_dquat();
        if turn.w < 0.0 {
            turn = -turn;
        }
        let angle = |part: f64| 2.0 * libm::asin(part.clamp(-1.0, 1.0));
        let along = axes.transpose() * apart;
        let place = [
            along.x,
            along.y,
            along.z,
            angle(turn.x),
            angle(turn.y),
            angle(turn.z),
        ];
        let anchor = frames[1].translation;
        let [first, second] = bodies.map(|body| body.velocity_at_point(anchor).as_dvec3());
        let linear = axes.transpose() * (second - first);
        let [first, second] = bodies.map(|body| body.angvel().as_dvec3());
        let angular = axes.transpose() * (second - first);
        let rates = [
            linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
        ];
        let locked = joint.data.locked_axes.bits();
        let pair = bodies.map(Ease::of);
        let [one, other] = handles;
        let sides = [[one, other], [other, one]].map(|ends| side(world, handle, ends, holding));
        let [one, other] = sides;
        let sides = one.zip(other).map(|(one, other)| [one, other]);
        Some(Self {
            poses,
            anchor: frames[1].translation.as_dvec3(),
            axes,
            locked: [0, 1, 2, 3, 4, 5].map(|axis| locked >> axis & 1 != 0),
            place,
            rates,
            step: f64::from(world.integration_parameters.dt),
            pair,
            held: sides.as_ref().and_then(|sides| held_together(world, sides)),
            sides,
        })
    }

    /// Unit push of an axis.
    fn axis(&self, axis: usize) -> Six {
        let direction = self.axes.col(axis % 3);
        match axis < 3 {
            true => Six {
                linear: direction,
                angular: DVec3::ZERO,
            },
            false => Six {
                linear: DVec3::ZERO,
                angular: direction,
            },
        }
    }

    /// Relative velocity at the anchor by a push between the two sides.
    fn answer(&self, sides: &[Ease; 2], push: Six) -> Six {
        let [first, second] = sides.map(|side| side.answer(self.anchor, push));
        first.plus(1.0, second)
    }

    /// The push of a motor with what the locked axes add, so that these do not move; and the answer to it.
    fn freed(&self, sides: &[Ease; 2], motor: usize) -> (Six, Six) {
        // Modified Gram-Schmidt over the locked axes, in the measure of the answers.
        let mut basis: Vec<(Six, Six)> = Vec::with_capacity(6);
        let freed = |basis: &[(Six, Six)], push: Six| {
            let (mut push, mut answer) = (push, self.answer(sides, push));
            for (other, other_answer) in basis {
                let share = -push.dot(*other_answer) / other.dot(*other_answer);
                push = push.plus(share, *other);
                answer = answer.plus(share, *other_answer);
            }
            (push, answer)
        };
        for axis in (0..6).filter(|axis| self.locked[*axis]) {
            let own = self.answer(sides, self.axis(axis)).dot(self.axis(axis));
            let (push, answer) = freed(&basis, self.axis(axis));
            // An axis that the others lock already, or that nothing moves.
            if push.dot(answer) > own * 1e-9 {
                basis.push((push, answer));
            }
        }
        freed(&basis, self.axis(motor))
    }

    /// The best row for the motor of an axis.
    fn row(&self, axis: usize) -> Row {
        let unit = self.axis(axis);
        let (push, answer) = self.freed(&self.pair, axis);
        let ease = answer.dot(unit).max(f64::MIN_POSITIVE);
        // Velocities for each unit of the motor's, with the locked axes at rest.
        let motion = Six {
            linear: answer.linear / ease,
            angular: answer.angular / ease,
        };
        let whole = self.held.map_or(ease, |held| {
            let (_, answer) = self.freed(&held, axis);
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
                ease: [own, (scale * scale * whole).min(own)],
            }
        };
        let plain = row(match axis < 3 {
            true => Line::Force(unit.linear, self.anchor),
            false => Line::Torque(unit.angular),
        });
        let loss = |row: &Row| 1.0 - row.scale * row.scale * ease / row.ease[0];
        let force = push.linear.length();
        if force <= f64::MIN_POSITIVE || loss(&plain) <= LOSS {
            return plain;
        }
        let direction = push.linear / force;
        let offset = direction.cross(push.angular) / force;
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

    /// What the position of a motor lacks, metres or radians.
    fn lack(&self, axis: usize, motor: &Motor) -> f64 {
        let lack = f64::from(motor.position) - self.place[axis];
        match axis < 3 {
            true => lack,
            false => wrapped(lack),
        }
    }

    /// The bodies that the motor of an axis moves, if the other side holds to something that stands still.
    fn moved(&self, world: &PhysicsWorld, axis: usize) -> Option<Vec<MovedBody>> {
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
        let direction = self.axes.col(axis % 3) * sign;
        let moved = side.iter().map(|handle| {
            let ease = Ease::of(world.bodies.get(*handle)?);
            let motion = match axis < 3 {
                true => Six {
                    linear: direction,
                    angular: DVec3::ZERO,
                },
                false => Six {
                    linear: direction.cross(ease.centre - self.anchor),
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
        let (axis, motor) = (row.axis, &row.motor);
        let (lack, speed) = (self.lack(axis, motor), f64::from(motor.velocity));
        if axis < 3 || matches!(row.row.line, Line::Torque(_)) {
            return [lack, speed];
        }
        let (turn, _) = after_step(motor, lack, self.rates[axis], (self.step, substep));
        let turn = turn.clamp(-LINE_TURN_MAX, LINE_TURN_MAX);
        let (sine, cosine) = (libm::sin(turn), libm::cos(turn));
        let rest = match turn.abs() < LINE_TURN_MAX {
            true => (lack - turn) * cosine,
            false => 0.0,
        };
        let mean = if turn == 0.0 { 1.0 } else { sine / turn };
        [sine + rest, speed * mean]
    }

    /// The joint of a motor for the next step. `coupled`: force or torque beside that of its law.
    fn motor(
        &self,
        of_row: &MotorRow,
        coupled: f64,
        (substep, collide): (f64, bool),
    ) -> GenericJoint {
        let (row, motor) = (&of_row.row, &of_row.motor);
        let [lack, speed] = self.straightened(of_row, substep);
        let Gains {
            stiffness,
            damping,
            share,
            ..
        } = gains(row, motor, substep);
        // A velocity that the motor lacks gives it this force more.
        let more = match share > 0.0 {
            true => coupled / row.scale * substep / share,
            false => 0.0,
        };
        // Of a motor that holds a position as a lack of position, so that its velocity stays what was asked for.
        let (more_lack, more_speed) = match stiffness > 0.0 {
            true => (more * (substep * stiffness + damping) / stiffness, 0.0),
            false => (0.0, more),
        };
        let (at, direction, driven) = match row.line {
            Line::Force(direction, point) => (point, direction, JointAxis::LinX),
            Line::Torque(direction) => (self.anchor, direction, JointAxis::AngX),
        };
        let turn = glam::Quat::from_rotation_arc(Vec3::X, direction.as_vec3());
        let there = RapierPose::from_parts(at.as_vec3(), turn.normalize());
        let [first, second] = self.poses.map(|pose| pose.inverse() * there);
        GenericJointBuilder::new(JointAxesMask::empty())
            .contacts_enabled(collide)
            .local_frame1(first)
            .local_frame2(second)
            .motor_model(driven, MotorModel::ForceBased)
            .set_motor(
                driven,
                (lack * row.scale + more_lack) as f32,
                (speed * row.scale + more_speed) as f32,
                stiffness as f32,
                damping as f32,
            )
            .motor_max_force(driven, (f64::from(motor.force) / row.scale) as f32)
            .build()
    }
}

/// The angle of a lack, the short way round, radians.
fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let turns = ((angle + PI) / TAU).floor();
    angle - turns * TAU
}

/// Stiffness and damping of a row, N/m and N·s/m or about it, that accelerate by the motor's.
///
/// A substep solves each row twice. With `a` and `b` the two eases of the row and `c` the softness of the motor, a row that
/// takes `x` of the lack for each pass gives the impulse `x · (1 + x · (a − b))`; one substep of the motor's law takes
/// `1 / (b · (1 + c))`.
fn gains(row: &Row, motor: &Motor, substep: f64) -> Gains {
    let [a, b] = row.ease;
    let (mut stiffness, mut damping) = (f64::from(motor.stiffness), f64::from(motor.damping));
    let softness =
        |stiffness: f64, damping: f64| 1.0 / (substep * substep * stiffness + substep * damping);
    let mut c = softness(stiffness, damping);
    let is_sound = c.is_finite() && b > 0.0;
    if !is_sound {
        return Gains::default();
    }
    let wanted = 1.0 / (b * (1.0 + c));
    let lost = a - b;
    let mut is_exact = true;
    let mut x = match lost > a * 1e-6 {
        true => ((1.0 + 4.0 * lost * wanted).sqrt() - 1.0) / (2.0 * lost),
        false => wanted,
    };
    if x > 1.0 / a {
        // The most that the row can do, at the same damping ratio.
        is_exact = false;
        x = 1.0 / a;
        c = a * a / (b * (2.0 * a - b)) - 1.0;
        let c = c.max(f64::EPSILON);
        let ratio = damping / (2.0 * stiffness.sqrt());
        if stiffness > 0.0 {
            let root = ((ratio * ratio + 1.0 / c).sqrt() - ratio) / substep;
            stiffness = root * root;
            damping = 2.0 * ratio * root;
        } else {
            damping = 1.0 / (c * substep);
        }
    }
    let yielding = (1.0 / x - a).max(a * 1e-6);
    let weight = softness(stiffness, damping) / yielding;
    Gains {
        stiffness: stiffness * weight,
        damping: damping * weight,
        share: x * (1.0 + x * lost),
        is_exact,
    }
}

/// The settings of a motor in Rapier.
#[derive(Default)]
struct Gains {
    /// N/m or N·m.
    stiffness: f64,
    /// N·s/m or N·m·s.
    damping: f64,
    /// Impulse of a substep for each unit of velocity that the row lacks.
    share: f64,
    /// False if the motor is too strong for the row.
    is_exact: bool,
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
