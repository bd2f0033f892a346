//! Contacts, sensors and joints of a body of a Rapier world after a step.
//!
//! Reads the world only. Rapier reports pairs of colliders, and a contact is one of bodies: of several the deepest
//! counts, and their forces add up.

use rapier3d::prelude::{
    Collider, ContactPair, JointAxesMask, PhysicsWorld, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::Contact;
use rhumb_reckoning::BodyId;

use super::rapier_body::id;

/// Adds one contact for each body that touches this one, in the order of ids.
pub(super) fn contacts(
    world: &PhysicsWorld,
    of: RigidBodyHandle,
    body: &RigidBody,
    out: &mut Vec<Contact>,
) {
    let mut found = Vec::new();
    for collider in body.colliders() {
        let pairs = world.contact_pairs_with(*collider);
        found.extend(pairs.filter_map(|pair| contact(world, of, pair)));
    }
    found.sort_by(|a, b| (a.with.cmp(&b.with)).then(a.separation.total_cmp(&b.separation)));
    let first = out.len();
    for contact in found {
        match out[first..].last_mut() {
            Some(deepest) if deepest.with == contact.with => deepest.force += contact.force,
            _ => out.push(contact),
        }
    }
}

/// The deepest contact of a pair of colliders, from the first one's body or the second's.
fn contact(world: &PhysicsWorld, of: RigidBodyHandle, pair: &ContactPair) -> Option<Contact> {
    if !pair.has_any_active_contact() {
        return None;
    }
    let [first, second] =
        [pair.collider1, pair.collider2].map(|handle| world.colliders.get(handle));
    let (first, second) = (first?, second?);
    let (manifold, deepest) = pair.find_deepest_contact()?;
    // From the first collider towards the second.
    let normal = manifold.data.normal;
    let at = |collider: &Collider, point| collider.position().transform_point(point);
    let is_first = first.parent() == Some(of);
    let (other, point, normal) = if is_first {
        (second, at(first, deepest.local_p1), -normal)
    } else {
        (first, at(second, deepest.local_p2), normal)
    };
    let contact = Contact {
        with: id(world.bodies.get(other.parent()?)?),
        point,
        normal,
        separation: deepest.dist,
        force: pair.total_impulse_magnitude() / world.integration_parameters.dt,
    };
    let finite = [contact.separation, contact.force]
        .iter()
        .all(|n| n.is_finite());
    (finite && point.is_finite() && normal.is_finite()).then_some(contact)
}

/// True if a body touches another one.
pub(super) fn is_touched(world: &PhysicsWorld, body: &RigidBody) -> bool {
    let mut colliders = body.colliders().iter();
    colliders.any(|collider| {
        let mut pairs = world.contact_pairs_with(*collider);
        pairs.any(ContactPair::has_any_active_contact)
    })
}

/// True if a body has a joint.
pub(super) fn has_joints(world: &PhysicsWorld, of: RigidBodyHandle) -> bool {
    world.impulse_joints.attached_joints(of).next().is_some()
}

/// True if a body touches another one or has a joint.
pub(super) fn is_bound(world: &PhysicsWorld, of: RigidBodyHandle, body: &RigidBody) -> bool {
    has_joints(world, of) || is_touched(world, body)
}

/// True if a body touches another one that may carry it: of two bodies with joints neither carries the other.
pub(super) fn is_supported(world: &PhysicsWorld, of: RigidBodyHandle, body: &RigidBody) -> bool {
    let hangs = has_joints(world, of);
    let carries = |pair: &ContactPair, first| {
        let other = match pair.collider1 == first {
            true => pair.collider2,
            false => pair.collider1,
        };
        let other = world.colliders.get(other).and_then(Collider::parent);
        other.is_some_and(|other| {
            let dynamic = (world.bodies.get(other)).is_some_and(RigidBody::is_dynamic);
            !(hangs && dynamic && has_joints(world, other))
        })
    };
    body.colliders().iter().any(|collider| {
        let mut pairs = world.contact_pairs_with(*collider);
        pairs.any(|pair| pair.has_any_active_contact() && carries(pair, *collider))
    })
}

/// The motion to which a joint's motor drives a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Drive {
    /// A place.
    Position,
    /// A velocity other than zero.
    Velocity,
}

/// The motor that moves a body by one of its joints, if any does.
pub(super) fn motor(world: &PhysicsWorld, of: RigidBodyHandle) -> Option<Drive> {
    let joints = world.impulse_joints.attached_joints(of);
    let motors = joints.flat_map(|(_, _, _, joint)| {
        let driven = joint.data.motor_axes;
        let motors = joint.data.motors.iter().enumerate();
        motors
            .filter(move |(axis, _)| driven.contains(JointAxesMask::from_bits_truncate(1 << axis)))
    });
    let drives = motors.filter_map(|(_, motor)| match motor {
        motor if motor.target_vel != 0.0 && motor.damping > 0.0 => Some(Drive::Velocity),
        motor if motor.stiffness > 0.0 => Some(Drive::Position),
        _ => None,
    });
    drives.max()
}

/// Adds the pairs of a sensor and a body inside it that this body is part of; a pair may come more than once.
pub(super) fn sensed(world: &PhysicsWorld, body: &RigidBody, out: &mut Vec<(BodyId, BodyId)>) {
    let owner = |collider: &Collider| world.bodies.get(collider.parent()?).map(id);
    for collider in body.colliders() {
        for (_, first, _, second, inside) in world.intersection_pairs_with(*collider) {
            let (Some(one), Some(other)) = (owner(first), owner(second)) else {
                continue;
            };
            if inside && first.is_sensor() {
                out.push((one, other));
            }
            if inside && second.is_sensor() {
                out.push((other, one));
            }
        }
    }
}
