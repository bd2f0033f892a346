//! A Rapier joint with motors, as it is before a step.
//!
//! Reads the world only.

use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    GenericJoint, ImpulseJointHandle, PhysicsWorld, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::Motor;

use super::rapier_ease::{Ease, Six, held_together, side};

/// A joint as it is before a step.
pub(super) struct HeldJoint {
    pub(super) poses: [RapierPose; 2],
    pub(super) anchor: DVec3,
    /// Directions of the axes: those of the first frame.
    pub(super) axes: DMat3,
    pub(super) locked: [bool; 6],
    /// The limits of the joint, by axis: metres, radians.
    pub(super) limits: [Option<[f64; 2]>; 6],
    /// Place of the second frame in the first, by axis: metres, radians.
    pub(super) place: [f64; 6],
    /// Rotation of the second frame in the first.
    pub(super) turn: DQuat,
    /// Relative velocity along and about the axes, m/s and rad/s.
    pub(super) rates: [f64; 6],
    /// Length of a step, seconds.
    pub(super) step: f64,
    pub(super) pair: [Ease; 2],
    /// The bodies that are held together with either; `None` if they are the same.
    pub(super) sides: Option<[Vec<RigidBodyHandle>; 2]>,
    pub(super) held: Option<[Ease; 2]>,
}

impl HeldJoint {
    /// `None` for a joint whose bodies are not there or do not move.
    pub(super) fn of(
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
        let limits = limits(&joint.data);
        let mut place = [
            along.x,
            along.y,
            along.z,
            angle(turn.x),
            angle(turn.y),
            angle(turn.z),
        ];
        within(&mut place, &limits);
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
            limits,
            place,
            turn,
            rates,
            step: f64::from(world.integration_parameters.dt),
            pair,
            held: sides.as_ref().and_then(|sides| held_together(world, sides)),
            sides,
        })
    }

    /// Unit push of an axis.
    pub(super) fn axis(&self, axis: usize) -> Six {
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
    pub(super) fn answer(&self, sides: &[Ease; 2], push: Six) -> Six {
        let [first, second] = sides.map(|side| side.answer(self.anchor, push));
        first.plus(1.0, second)
    }

    /// The push of a motor with what the locked axes add, so that these do not move; and the answer to it.
    pub(super) fn freed(&self, sides: &[Ease; 2], motor: Six) -> (Six, Six) {
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
        freed(&basis, motor)
    }

    /// The distance from a motor to its position, metres or radians. A turn without limits is driven the short way round.
    pub(super) fn lack(&self, axis: usize, motor: &Motor) -> f64 {
        let target = f64::from(motor.position);
        let lack = target - self.place[axis];
        let Some([least, most]) = self.limits[axis] else {
            return if axis < 3 { lack } else { wrapped(lack) };
        };
        let allows = |target: &f64| (least..=most).contains(target);
        if axis < 3 || allows(&target) {
            return lack;
        }
        // A target that the limits allow a whole turn from here.
        let turned = [target - TAU, target + TAU].into_iter().find(allows);
        turned.unwrap_or(target) - self.place[axis]
    }
}

/// The limits of a joint, by axis: metres, radians.
fn limits(joint: &GenericJoint) -> [Option<[f64; 2]>; 6] {
    let limited = joint.limit_axes.bits();
    [0, 1, 2, 3, 4, 5].map(|axis| {
        let limits = &joint.limits[axis];
        (limited >> axis & 1 != 0).then(|| [limits.min, limits.max].map(f64::from))
    })
}

/// Takes each turn with limits as the one that is the nearest to their middle.
fn within(place: &mut [f64; 6], limits: &[Option<[f64; 2]>; 6]) {
    for (place, limits) in place.iter_mut().zip(limits).skip(3) {
        if let Some([least, most]) = limits {
            let middle = (least + most) * 0.5;
            *place = middle + wrapped(*place - middle);
        }
    }
}

/// The angle of a lack, the short way round, radians.
fn wrapped(angle: f64) -> f64 {
    let turns = ((angle + PI) / TAU).floor();
    angle - turns * TAU
}
