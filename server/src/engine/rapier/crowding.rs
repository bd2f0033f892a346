//! Count of the pairs that the next step of a Rapier world meets first.
//!
//! A step cannot be cancelled, and its time and memory grow with the pairs of boxes that overlap. They are counted before
//! it, by the boxes of what commands have placed since the last step, and of what moved further than its size in that step.
//! Pairs of bodies that neither move count for nothing, and each collider has [`FREE`] for nothing: a heap has fewer for
//! each. A collider is searched for [`PAIRS_PER_COLLIDER`] at most. Nothing here changes a step.

use std::collections::BTreeMap;
use std::ops::Range;

use glam::Vec3;
use rapier3d::parry::bounding_volume::Aabb;
use rapier3d::parry::partitioning::Bvh;
use rapier3d::prelude::{Collider, PhysicsWorld, RigidBody, Shape, ShapeType};
use rhumb_reckoning::BodyId;

use super::body::id;

/// Pairs of a collider that do not count. The boxes of equal bodies in a heap overlap with a dozen others.
const FREE: u64 = 32;
/// Greatest count of one collider: a floor or a lift under thousands of bodies is no crowd.
const PAIRS_PER_COLLIDER: usize = 4_096;
/// Half the size of the world in which boxes are compared, metres: those of half-spaces have no end.
const WORLD: f32 = 1e6;
/// Displacement in a step below which no body moves further than its size, metres: half of the smallest shape.
const SHORT: f32 = 1e-3;
/// Ends of pairs that the last step had for one that counts: the step has shown that it ends, and grows slowly from then on.
const STANDING_SHARE: u64 = 4;
/// Pairs of a world below which no collider of it is looked at after a step.
const FEW: usize = 20_000;

/// The pairs before the next step.
#[derive(Clone, Default)]
pub(super) struct RapierCrowding {
    /// Nothing is counted beyond it; `None` until the count is asked for.
    most: Option<u32>,
    /// Boxes of colliders that were placed since the last step, by their number in `placed`.
    tree: Bvh,
    placed: Vec<Placed>,
    /// The numbers of a body's colliders.
    of_body: BTreeMap<BodyId, Range<u32>>,
    pairs: u64,
}

/// A collider that was placed since the last step.
#[derive(Clone, Copy)]
struct Placed {
    body: BodyId,
    moves: bool,
}

/// A body whose pairs are counted.
#[derive(Clone, Copy)]
pub(super) struct Crowded {
    pub(super) body: BodyId,
    /// True unless it neither moves nor notices what does.
    pub(super) moves: bool,
}

impl RapierCrowding {
    /// Counts from now on, until there are more than so many.
    pub(super) const fn begin(&mut self, most: u32) {
        self.most = Some(most);
    }

    /// True unless nothing more is to be counted.
    fn counts(&self) -> bool {
        self.most.is_some_and(|most| self.pairs <= u64::from(most))
    }

    /// Pairs beyond those that do not count.
    pub(super) const fn pairs(&self) -> u64 {
        self.pairs
    }

    /// Pairs that colliders with these boxes and weights would add.
    pub(super) fn pairs_with(
        &self,
        world: &PhysicsWorld,
        of: Crowded,
        parts: impl Iterator<Item = (Aabb, u64)>,
    ) -> u64 {
        let pairs = parts.map(|(aabb, weight)| weight * self.pairs_of(world, of, &bounded(aabb)));
        pairs.sum()
    }

    fn pairs_of(&self, world: &PhysicsWorld, of: Crowded, aabb: &Aabb) -> u64 {
        let placed = self.tree.intersect_aabb(aabb);
        let placed = placed.filter(|number| {
            let other = self.placed[*number as usize];
            other.body != of.body && (of.moves || other.moves)
        });
        let query = world.query_pipeline();
        let found = query.intersect_aabb_conservative(*aabb);
        let found = found.filter(|(_, collider)| {
            let other = collider.parent().and_then(|body| world.bodies.get(body));
            other.is_some_and(|body| {
                let other = id(body);
                let is_elsewhere = other == of.body || self.of_body.contains_key(&other);
                !is_elsewhere && (of.moves || moves(body, collider))
            })
        });
        let pairs = placed.take(PAIRS_PER_COLLIDER).count();
        let pairs = pairs + found.take(PAIRS_PER_COLLIDER - pairs).count();
        (pairs as u64).saturating_sub(FREE)
    }

    /// Notes that a body was placed, and counts its pairs.
    pub(super) fn place(&mut self, world: &PhysicsWorld, body: &RigidBody) {
        if !self.counts() {
            return;
        }
        let body_id = id(body);
        self.remove(body_id);
        if !body.is_enabled() {
            return;
        }
        let first = self.placed.len() as u32;
        let colliders = body.colliders().iter();
        for collider in colliders.filter_map(|solid| world.colliders.get(*solid)) {
            let at = match collider.position_wrt_parent() {
                Some(local) => *body.position() * *local,
                None => *body.position(),
            };
            let aabb = bounded(collider.shape().compute_aabb(&at));
            let moves = moves(body, collider);
            let body = body_id;
            let pairs = self.pairs_of(world, Crowded { body, moves }, &aabb);
            self.pairs += weight(collider.shape()) * pairs;
            self.tree.insert(aabb, self.placed.len() as u32);
            self.placed.push(Placed { body, moves });
        }
        (self.of_body).insert(body_id, first..self.placed.len() as u32);
    }

    /// Forgets where a body was placed; what it counted stays until the next step.
    pub(super) fn remove(&mut self, body: BodyId) {
        if let Some(numbers) = self.of_body.remove(&body) {
            numbers.for_each(|number| self.tree.remove(number));
        }
    }

    /// Begins anew after a step: with the pairs of the bodies that moved further than their size, and with those that all
    /// colliders have if they are many.
    pub(super) fn after<'a>(
        &mut self,
        world: &PhysicsWorld,
        awake: impl Iterator<Item = &'a RigidBody>,
    ) {
        let Some(most) = self.most else {
            return;
        };
        if !self.placed.is_empty() {
            *self = Self::default();
            self.begin(most);
        }
        let dt = world.integration_parameters.dt;
        // Each pair of bodies that move has two ends.
        let mut ends = 0;
        for body in awake {
            let way = body.linvel().length() * dt;
            if way < SHORT || body.is_fixed() || ends / 2 > u64::from(most) {
                continue;
            }
            let colliders = body.colliders().iter();
            for handle in colliders {
                let Some(collider) = world.colliders.get(*handle) else {
                    continue;
                };
                let aabb = collider.compute_aabb();
                if way > aabb.half_extents().min_element() {
                    let of = Crowded {
                        body: id(body),
                        moves: true,
                    };
                    let known = world.narrow_phase.contact_pairs_with(*handle).count();
                    let pairs = self.pairs_of(world, of, &bounded(aabb));
                    let new = pairs.saturating_sub(known as u64);
                    ends += weight(collider.shape()) * new;
                }
            }
        }
        self.pairs = ends / 2 + standing_ends(world) / STANDING_SHARE;
    }
}

/// Ends of the pairs that colliders have in the world, beyond those that do not count.
fn standing_ends(world: &PhysicsWorld) -> u64 {
    let graph = world.narrow_phase.contact_graph().raw_graph();
    let edges = graph.raw_edges();
    if edges.len() < FEW {
        return 0;
    }
    let mut pairs = vec![0_u64; graph.raw_nodes().len()];
    for edge in edges {
        for end in [edge.source(), edge.target()] {
            pairs[end.index()] += 1;
        }
    }
    let counted = pairs.into_iter().map(|pairs| {
        let pairs = pairs.min(PAIRS_PER_COLLIDER as u64);
        pairs.saturating_sub(FREE)
    });
    counted.sum()
}

/// True unless a collider's body neither moves nor notices what does.
pub(super) fn moves(body: &RigidBody, collider: &Collider) -> bool {
    !body.is_fixed() || collider.is_sensor()
}

/// Pairs of balls, boxes or capsules for one pair of a collider of this shape: the points in which solids of many faces
/// touch are searched for.
pub(super) fn weight(shape: &dyn Shape) -> u64 {
    match shape.shape_type() {
        ShapeType::Cylinder
        | ShapeType::Cone
        | ShapeType::ConvexPolyhedron
        | ShapeType::RoundCuboid
        | ShapeType::RoundCylinder
        | ShapeType::RoundCone
        | ShapeType::RoundConvexPolyhedron => 8,
        _ => 1,
    }
}

/// A box that has an end.
fn bounded(aabb: Aabb) -> Aabb {
    let within = |corner: Vec3| corner.clamp(Vec3::splat(-WORLD), Vec3::splat(WORLD));
    Aabb::new(within(aabb.mins), within(aabb.maxs))
}
