//! A Rapier joint with motors, and how easily its bodies move, before a step.
//!
//! Reads the world only. Bodies that joints or motors hold together count as one rigid body.

use std::collections::{BTreeSet, VecDeque};
use std::f64::consts::{PI, TAU};

use glam::{DMat3, DQuat, DVec3, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    GenericJoint, ImpulseJointHandle, JointAxesMask, PhysicsWorld, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::Motor;

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

/// Bodies that are taken for one rigid body at most, on either side of a joint.
const HELD_MAX: usize = 64;

/// A force, then a torque at the anchor; or the linear and angular velocity that go with them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Six {
    pub(super) linear: DVec3,
    pub(super) angular: DVec3,
}

impl Six {
    pub(super) fn dot(self, other: Self) -> f64 {
        self.linear.dot(other.linear) + self.angular.dot(other.angular)
    }

    pub(super) fn plus(self, share: f64, other: Self) -> Self {
        Self {
            linear: self.linear + other.linear * share,
            angular: self.angular + other.angular * share,
        }
    }
}

/// The ease with which a body, or several that are held together, is moved: inverse mass.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ease {
    pub(super) centre: DVec3,
    /// Along the axes of the world, 1/kg.
    pub(super) linear: DVec3,
    /// 1/(kg·m²), world axes.
    pub(super) angular: DMat3,
}

impl Ease {
    pub(super) fn of(body: &RigidBody) -> Self {
        let properties = body.mass_properties();
        let turned = properties.effective_world_inv_inertia;
        let column = |axis: Vec3| (turned * axis).as_dvec3();
        Self {
            centre: body.center_of_mass().as_dvec3(),
            linear: properties.effective_inv_mass.as_dvec3(),
            angular: DMat3::from_cols(column(Vec3::X), column(Vec3::Y), column(Vec3::Z)),
        }
    }

    /// True if nothing keeps it from moving and turning.
    pub(super) fn is_free(&self) -> bool {
        self.linear.min_element() > 0.0 && self.angular.determinant() > 0.0
    }

    /// Velocity of a point of the body by an impulse there.
    pub(super) fn answer(&self, point: DVec3, push: Six) -> Six {
        let lever = point - self.centre;
        let angular = self.angular * (push.angular + lever.cross(push.linear));
        Six {
            linear: self.linear * push.linear + angular.cross(lever),
            angular,
        }
    }
}

/// The bodies that are held together with either body of a joint; `None` if there are no others.
pub(super) fn held_together(
    world: &PhysicsWorld,
    sides: &[Vec<RigidBodyHandle>; 2],
) -> Option<[Ease; 2]> {
    if sides.iter().all(|side| side.len() == 1) {
        return None;
    }
    let [first, second] = sides;
    Some([together(world, first), together(world, second)])
}

/// The bodies that are held together with the first of two; `None` if the second is one of them, or they are too many.
pub(super) fn side(
    world: &PhysicsWorld,
    joint: ImpulseJointHandle,
    [first, second]: [RigidBodyHandle; 2],
    holding: &BTreeSet<(u32, u32)>,
) -> Option<Vec<RigidBodyHandle>> {
    let (mut found, mut next) = (vec![first], VecDeque::from([first]));
    while let Some(body) = next.pop_front() {
        // A body that does not move holds all that is held by it; nothing behind it counts.
        if !world.bodies.get(body).is_some_and(RigidBody::is_dynamic) {
            continue;
        }
        for (one, other, handle, attached) in world.impulse_joints.attached_joints(body) {
            let holds = attached.data.locked_axes == JointAxesMask::all()
                || holding.contains(&handle.into_raw_parts());
            if handle == joint || !holds {
                continue;
            }
            let far = if one == body { other } else { one };
            let is_enabled = world.bodies.get(far).is_some_and(RigidBody::is_enabled);
            if !is_enabled || found.contains(&far) {
                continue;
            }
            if far == second || found.len() == HELD_MAX {
                return None;
            }
            found.push(far);
            next.push_back(far);
        }
    }
    Some(found)
}

/// Bodies as one. One that does not move holds all.
fn together(world: &PhysicsWorld, bodies: &[RigidBodyHandle]) -> Ease {
    let bodies: Vec<_> = bodies
        .iter()
        .filter_map(|handle| world.bodies.get(*handle))
        .collect();
    let fixed = Ease {
        centre: DVec3::ZERO,
        linear: DVec3::ZERO,
        angular: DMat3::ZERO,
    };
    let eases: Vec<_> = bodies.iter().map(|body| Ease::of(body)).collect();
    if let [alone] = &eases[..] {
        return *alone;
    }
    if !eases.iter().all(Ease::is_free) {
        return fixed;
    }
    let mass: f64 = eases.iter().map(|ease| 1.0 / ease.linear.x).sum();
    let moment: DVec3 = eases.iter().map(|ease| ease.centre / ease.linear.x).sum();
    let centre = moment / mass;
    let mut inertia = DMat3::ZERO;
    for ease in &eases {
        let (own, arm) = (1.0 / ease.linear.x, ease.centre - centre);
        let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
        inertia += ease.angular.inverse() + (DMat3::IDENTITY * arm.length_squared() - outer) * own;
    }
    Ease {
        centre,
        linear: DVec3::splat(1.0 / mass),
        angular: inertia.inverse(),
    }
}
