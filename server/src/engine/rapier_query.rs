//! Queries in a Rapier world.
//!
//! Reads the world only. The tree of colliders is that of the last step.

use rapier3d::parry::shape::CompositeShape;
use rapier3d::prelude::{
    Collider, ColliderHandle, PhysicsWorld, QueryFilter as RapierFilter, RigidBody,
};
use rhumb_protocol::scene::{Answer, BodyKind, Query, QueryCandidate, QueryFilter};
use rhumb_reckoning::BodyId;
use rhumb_solids::{SearchedBodies, SolidPart};

use super::rapier_body::id;

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
