//! Reports of a Rapier world after a step: contacts, sensors, joints, queries.
//!
//! Reads the world only. Rapier reports pairs of colliders, and a contact is one of bodies: of several the deepest
//! counts, and their forces add up. The tree of colliders, which queries search, is that of the last step.

use rapier3d::parry::shape::CompositeShape;
use rapier3d::prelude::{
    Collider, ColliderHandle, ContactPair, JointAxesMask, PhysicsWorld,
    QueryFilter as RapierFilter, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::{Answer, BodyKind, Contact, Query, QueryCandidate, QueryFilter};
use rhumb_reckoning::BodyId;
use rhumb_solids::{SearchedBodies, SolidPart};

use super::body::id;

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

/// The answer to a query.
pub(super) fn answer(world: &PhysicsWorld, query: &Query) -> Answer {
    rhumb_solids::answer(&Searched { world }, query)
}

/// The bodies of a world.
struct Searched<'a> {
    world: &'a PhysicsWorld,
}

impl Searched<'_> {
    fn owner(&self, collider: &Collider) -> Option<&RigidBody> {
        self.world.bodies.get(collider.parent()?)
    }
}

impl SearchedBodies for Searched<'_> {
    fn search(
        &self,
        filter: &QueryFilter,
        before: &[BodyId],
        find: &mut dyn FnMut(&dyn CompositeShape),
    ) {
        let counts = |_: ColliderHandle, collider: &Collider| {
            self.owner(collider).is_some_and(|body| {
                let candidate = candidate(body, collider);
                filter.takes(&candidate) && !before.contains(&candidate.id)
            })
        };
        let rapier = RapierFilter {
            predicate: Some(&counts),
            ..RapierFilter::default()
        };
        find(&self.world.query_pipeline_with_filter(rapier));
    }

    fn body_of(&self, part: u32) -> Option<BodyId> {
        let (collider, _) = self.world.colliders.get_unknown_gen(part)?;
        self.owner(collider).map(id)
    }

    fn parts_of(&self, body: BodyId) -> Vec<SolidPart> {
        let mut bodies = self.world.bodies.iter();
        let Some((_, body)) = bodies.find(|(_, other)| id(other) == body) else {
            return Vec::new();
        };
        let solids = body.colliders().iter();
        let solids = solids.filter_map(|solid| self.world.colliders.get(*solid));
        let counts = |solid: &&Collider| QueryFilter::ALL.takes(&candidate(body, solid));
        let parts = solids
            .filter(|solid| solid.is_enabled())
            .filter(counts)
            .map(|solid| SolidPart {
                at: *solid.position(),
                shape: solid.shared_shape().clone(),
            });
        parts.collect()
    }
}

/// The properties of a body that a filter reads, by one of its colliders.
fn candidate(body: &RigidBody, collider: &Collider) -> QueryCandidate {
    let kind = if body.is_fixed() {
        BodyKind::Fixed
    } else if body.is_kinematic() {
        BodyKind::Kinematic
    } else {
        BodyKind::Dynamic
    };
    QueryCandidate {
        id: id(body),
        kind,
        is_sensor: collider.is_sensor(),
        members: collider.collision_groups().memberships.bits(),
    }
}
