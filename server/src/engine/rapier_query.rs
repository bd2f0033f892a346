//! Queries in a Rapier world.
//!
//! Reads the world only. The tree of colliders is that of the last step.

use rapier3d::parry::shape::CompositeShape;
use rapier3d::prelude::{
    Collider, ColliderHandle, PhysicsWorld, QueryFilter as RapierFilter, QueryFilterFlags,
    RigidBodyHandle,
};
use rhumb_protocol::scene::{Answer, Query, QueryFilter};
use rhumb_reckoning::BodyId;
use rhumb_solids::SearchedBodies;

use super::rapier_body::id;

/// The answer to a query; `except` is the excluded body.
pub(super) fn answer(
    world: &PhysicsWorld,
    except: Option<RigidBodyHandle>,
    query: &Query,
) -> Answer {
    rhumb_solids::answer(&Searched { world, except }, query)
}

/// The bodies of a world.
struct Searched<'a> {
    world: &'a PhysicsWorld,
    except: Option<RigidBodyHandle>,
}

impl Searched<'_> {
    /// Rapier's filter, less what the predicate decides.
    fn rapier<'a>(
        &self,
        filter: &QueryFilter,
        predicate: &'a dyn Fn(ColliderHandle, &Collider) -> bool,
    ) -> RapierFilter<'a> {
        let mut flags = QueryFilterFlags::empty();
        for (without, flag) in [
            (!filter.with_static, QueryFilterFlags::EXCLUDE_FIXED),
            (!filter.with_dynamic, QueryFilterFlags::EXCLUDE_DYNAMIC),
            (!filter.with_kinematic, QueryFilterFlags::EXCLUDE_KINEMATIC),
            (!filter.with_sensors, QueryFilterFlags::EXCLUDE_SENSORS),
        ] {
            flags.set(flag, without);
        }
        RapierFilter {
            flags,
            exclude_rigid_body: self.except,
            predicate: Some(predicate),
            ..RapierFilter::default()
        }
    }

    fn owner(&self, collider: &Collider) -> Option<BodyId> {
        self.world.bodies.get(collider.parent()?).map(id)
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
            let memberships = collider.collision_groups().memberships;
            let owner = self.owner(collider);
            memberships.bits() & filter.groups != 0 && owner.is_some_and(|id| !before.contains(&id))
        };
        let rapier = self.rapier(filter, &counts);
        find(&self.world.query_pipeline_with_filter(rapier));
    }

    fn body_of(&self, part: u32) -> Option<BodyId> {
        let (collider, _) = self.world.colliders.get_unknown_gen(part)?;
        self.owner(collider)
    }
}
