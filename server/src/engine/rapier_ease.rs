//! Inverse masses of bodies of a Rapier world, alone or held together.
//!
//! Reads the world only. Bodies that joints or motors hold together count as one rigid body.

use std::collections::{BTreeSet, VecDeque};

use glam::{DMat3, DVec3, Vec3};
use rapier3d::prelude::{
    ImpulseJointHandle, JointAxesMask, PhysicsWorld, RigidBody, RigidBodyHandle,
};

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
