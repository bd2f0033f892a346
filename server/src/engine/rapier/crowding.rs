//! Count of the pairs that the next step of a Rapier world meets first.
//!
//! A step cannot be cancelled, and its time and memory grow with the pairs of boxes that overlap. They are counted before
//! it, by the boxes of what commands have placed since the last step, of what the step puts elsewhere before it meets
//! anything, and of what left its box by more than its size, by moving or turning. A pair that Rapier finds and makes nothing
//! of counts as one of [`SHARES`]; each collider has [`FREE`] others for nothing: a heap has fewer for each. A collider is
//! searched for [`PAIRS_PER_COLLIDER`] at most. Nothing here changes a step.

use std::collections::BTreeMap;
use std::mem;
use std::ops::Range;

use glam::{Quat, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::partitioning::Bvh;
use rapier3d::parry::shape::TypedShape;
use rapier3d::prelude::{
    ActiveCollisionTypes, Collider, ColliderGraphIndex, InteractionGroups, PhysicsWorld, RigidBody,
    RigidBodyHandle, RigidBodyType, Shape, ShapeType,
};
use rhumb_reckoning::BodyId;

use super::body::id;

/// Pairs of a collider that do not count. The boxes of equal bodies in a heap overlap with a dozen others.
const FREE: u64 = 32;
/// Greatest count of one collider: a floor or a lift under thousands of bodies is no crowd.
const PAIRS_PER_COLLIDER: u64 = 4_096;
/// Pairs that Rapier finds, and makes nothing of, for one that it makes: bodies that are fixed, or kinematic, or of
/// groups that do not touch.
const SHARES: u64 = 256;
/// Half the size of the world in which boxes are compared, metres: those of half-spaces have no end.
const WORLD: f32 = 1e6;
/// Ends of pairs that the last step had for one that counts: the step has shown that it ends, and grows slowly from then on.
const STANDING_SHARE: u64 = 4;
/// Pairs of a world below which no collider of it is looked at after a step.
const FEW: usize = 20_000;
/// Of so many awake bodies, one is searched after a step for pairs of which nothing is made: no list has those.
const SAMPLE: u32 = 128;

/// The pairs before the next step.
#[derive(Clone, Default)]
pub(super) struct RapierCrowding {
    /// Nothing is counted beyond it; `None` until the count is asked for.
    most: Option<u32>,
    /// Boxes of colliders that were placed since the last step, by their number in `placed`.
    tree: Bvh,
    placed: Vec<Crowded>,
    /// The numbers of a body's colliders.
    of_body: BTreeMap<BodyId, Range<u32>>,
    /// Where bodies were when they were last looked at, by their index.
    seen: Vec<Seen>,
    /// Ends of pairs in the last step, by the collider: the buffer of the next one.
    ends: Vec<u32>,
    /// The number of steps, which chooses the bodies that are searched.
    turn: u32,
    /// The count, in parts of a pair.
    shares: u64,
}

/// A collider whose pairs are counted.
#[derive(Clone, Copy)]
pub(super) struct Crowded {
    pub(super) body: BodyId,
    pub(super) kind: RigidBodyType,
    pub(super) types: ActiveCollisionTypes,
    pub(super) groups: InteractionGroups,
}

/// A body where it was last looked at.
#[derive(Clone, Copy)]
struct Seen {
    pose: RapierPose,
    /// From its origin to the farthest corner of its boxes, metres.
    reach: f32,
    /// A bound on half the size of its smallest box in any rotation, metres; 0 if that is not known.
    size: f32,
}

impl Crowded {
    fn of(body: &RigidBody, collider: &Collider) -> Self {
        Self {
            body: id(body),
            kind: body.body_type(),
            types: collider.active_collision_types(),
            groups: collider.collision_groups(),
        }
    }

    /// True if Rapier makes a pair of both where their boxes overlap.
    fn meets(&self, other: &Self) -> bool {
        let tests = |of: &Self| of.types.test(self.kind, other.kind);
        (tests(self) || tests(other)) && self.groups.test(other.groups)
    }
}

impl Seen {
    fn of(world: &PhysicsWorld, body: &RigidBody, pose: RapierPose) -> Self {
        let (mut reach, mut size) = (0.0_f32, f32::MAX);
        for collider in colliders(world, body) {
            let local = within(collider);
            let aabb = bounded(collider.shape().compute_aabb(&local));
            reach = reach.max(aabb.center().length() + aabb.half_extents().length());
            size = size.min(thickness(collider.shape()));
        }
        Self { pose, reach, size }
    }

    /// True if a body at this pose may have left a box by more than its size.
    fn may_have_left(&self, now: &RapierPose) -> bool {
        let moved = self.pose.translation.distance(now.translation);
        let turned = self.reach * 2.0 * chord(self.pose.rotation, now.rotation);
        moved + turned > self.size
    }
}

impl RapierCrowding {
    /// Counts from now on, until there are more than so many.
    pub(super) fn begin(&mut self, world: &PhysicsWorld, most: u32) {
        self.most = Some(most);
        for (_, body) in world.bodies.iter() {
            self.see(world, body, *body.position());
        }
    }

    /// True unless nothing more is to be counted.
    fn counts(&self) -> bool {
        self.most.is_some() && !self.is_beyond()
    }

    /// True if there are too many.
    pub(super) fn is_beyond(&self) -> bool {
        self.most.is_some_and(|most| self.pairs() > u64::from(most))
    }

    /// Pairs beyond those that do not count.
    pub(super) const fn pairs(&self) -> u64 {
        self.shares / SHARES
    }

    /// Pairs that a body with colliders of these boxes and weights would add.
    pub(super) fn pairs_with(
        &self,
        world: &PhysicsWorld,
        of: Crowded,
        parts: impl Iterator<Item = (Aabb, u64)>,
    ) -> u64 {
        let shares = parts.map(|part| self.shares_of(world, of, part, 0));
        shares.sum::<u64>() / SHARES
    }

    /// The parts of pairs that a collider of this box and weight adds, which has so many of its pairs already.
    fn shares_of(
        &self,
        world: &PhysicsWorld,
        of: Crowded,
        (aabb, weight): (Aabb, u64),
        known: u64,
    ) -> u64 {
        let aabb = bounded(aabb);
        let placed = self.tree.intersect_aabb(&aabb);
        let placed = placed.map(|number| self.placed[number as usize]);
        let query = world.query_pipeline();
        let found = query.intersect_aabb_conservative(aabb);
        let found = found.filter_map(|(_, collider)| {
            let body = world.bodies.get(collider.parent()?)?;
            let other = Crowded::of(body, collider);
            (!self.of_body.contains_key(&other.body)).then_some(other)
        });
        let (mut pairs, mut passed) = (0, 0);
        for other in placed.chain(found).filter(|other| other.body != of.body) {
            if of.meets(&other) {
                pairs += 1;
                if pairs == PAIRS_PER_COLLIDER {
                    break;
                }
            } else {
                passed += 1;
            }
        }
        let counted = pairs.saturating_sub(FREE + known) * weight;
        counted.min(PAIRS_PER_COLLIDER) * SHARES + passed
    }

    /// Notes where a body is.
    fn see(&mut self, world: &PhysicsWorld, body: &RigidBody, pose: RapierPose) {
        let index = id(body).index() as usize;
        let seen = Seen::of(world, body, pose);
        if index >= self.seen.len() {
            self.seen.resize(index + 1, seen);
        }
        self.seen[index] = seen;
    }

    /// Notes that a body was placed, and counts its pairs.
    pub(super) fn place(&mut self, world: &PhysicsWorld, body: &RigidBody) {
        self.place_at(world, body, body.position());
    }

    /// Notes that a body is put to a pose before the next step meets anything, and counts its pairs there.
    pub(super) fn place_at(&mut self, world: &PhysicsWorld, body: &RigidBody, pose: &RapierPose) {
        if self.most.is_none() {
            return;
        }
        self.see(world, body, *pose);
        let body_id = id(body);
        self.remove(body_id);
        if !body.is_enabled() || !self.counts() {
            return;
        }
        let first = self.placed.len() as u32;
        for collider in colliders(world, body) {
            let shape = collider.shape();
            let aabb = bounded(shape.compute_aabb(&(*pose * within(collider))));
            let of = Crowded::of(body, collider);
            self.shares += self.shares_of(world, of, (aabb, weight(shape)), 0);
            self.tree.insert(aabb, self.placed.len() as u32);
            self.placed.push(of);
        }
        (self.of_body).insert(body_id, first..self.placed.len() as u32);
    }

    /// Forgets where a body was placed; what it counted stays until the next step.
    pub(super) fn remove(&mut self, body: BodyId) {
        if let Some(numbers) = self.of_body.remove(&body) {
            numbers.for_each(|number| self.tree.remove(number));
        }
    }

    /// Begins anew after a step: with the pairs of the bodies that left their boxes, and with those that all colliders have
    /// if they are many.
    pub(super) fn after(
        &mut self,
        world: &PhysicsWorld,
        awake: impl Iterator<Item = (BodyId, RigidBodyHandle, RapierPose)> + Clone,
    ) {
        if self.most.is_none() {
            return;
        }
        self.turn = self.turn.wrapping_add(1);
        let passed = match self.may_pass_many(world) {
            true => self.passed_ends(world, awake.clone()),
            false => 0,
        };
        self.look(world, awake);
        let made = self.standing_ends(world) * SHARES;
        self.shares += (made + passed / 2) / STANDING_SHARE;
    }

    /// True if all colliders at one point would be too many, though Rapier made no pair of them.
    fn may_pass_many(&self, world: &PhysicsWorld) -> bool {
        let colliders = world.colliders.len() as u64;
        let most = self.most.map_or(u64::MAX, u64::from);
        colliders * colliders / (2 * SHARES) > most
    }

    /// Ends of pairs that Rapier finds and makes nothing of, by a sample of the awake bodies.
    fn passed_ends(
        &self,
        world: &PhysicsWorld,
        awake: impl Iterator<Item = (BodyId, RigidBodyHandle, RapierPose)>,
    ) -> u64 {
        let is_of_turn = |body: &BodyId| body.index() % SAMPLE == self.turn % SAMPLE;
        let sample = awake.filter(|(body, ..)| is_of_turn(body));
        let bodies = sample.filter_map(|(_, handle, _)| world.bodies.get(handle));
        let ends = bodies.flat_map(|body| {
            colliders(world, body).map(move |collider| {
                let of = Crowded::of(body, collider);
                let part = (collider.compute_aabb(), weight(collider.shape()));
                // Pairs that exist are in the world's lists.
                self.shares_of(world, of, part, PAIRS_PER_COLLIDER)
            })
        });
        ends.sum::<u64>() * u64::from(SAMPLE)
    }

    /// Begins anew within a step, or after it: with the pairs of the bodies that left their boxes.
    pub(super) fn look(
        &mut self,
        world: &PhysicsWorld,
        awake: impl Iterator<Item = (BodyId, RigidBodyHandle, RapierPose)>,
    ) {
        let Some(most) = self.most else {
            return;
        };
        if !self.placed.is_empty() {
            self.tree = Bvh::new();
            self.placed.clear();
            self.of_body.clear();
        }
        self.shares = 0;
        // Each pair of bodies that move has two ends.
        let ends_max = u64::from(most).saturating_mul(2 * SHARES);
        let mut ends = 0_u64;
        for (body, handle, now) in awake {
            let Some(seen) = self.seen.get_mut(body.index() as usize) else {
                continue;
            };
            let has_left = seen.may_have_left(&now);
            let before = mem::replace(&mut seen.pose, now);
            if !has_left || ends > ends_max {
                continue;
            }
            let Some(body) = world.bodies.get(handle) else {
                continue;
            };
            match self.ends_of(world, body, &before) {
                Some(new) => ends += new,
                None => self.place(world, body),
            }
        }
        self.shares += ends / 2;
    }

    /// The parts of pairs of the colliders of a body that have left their boxes; `None` if the world's tree has them
    /// elsewhere.
    fn ends_of(&self, world: &PhysicsWorld, body: &RigidBody, before: &RapierPose) -> Option<u64> {
        let mut ends = 0;
        for handle in body.colliders() {
            let Some(collider) = world.colliders.get(*handle) else {
                continue;
            };
            let (shape, local) = (collider.shape(), within(collider));
            let at = *body.position() * local;
            if *collider.position() != at {
                return None;
            }
            let [was, is] = [*before * local, at].map(|pose| bounded(shape.compute_aabb(&pose)));
            if was.loosened(was.half_extents().min_element()).contains(&is) {
                continue;
            }
            let narrow = &world.narrow_phase;
            let known = narrow.contact_pairs_with(*handle).count()
                + narrow.intersection_pairs_with(*handle).count();
            let part = (is, weight(shape));
            ends += self.shares_of(world, Crowded::of(body, collider), part, known as u64);
        }
        Some(ends)
    }

    /// Ends of the pairs that colliders have in the world, beyond those that do not count.
    fn standing_ends(&mut self, world: &PhysicsWorld) -> u64 {
        let contacts = world.narrow_phase.contact_graph().raw_graph();
        let nodes = contacts.raw_nodes().len();
        let ends = contacts.raw_edges().iter();
        let ends = ends.map(|edge| [edge.source(), edge.target()].map(ColliderGraphIndex::index));
        let of_contacts = self.count_ends(nodes, ends);
        let sensed = world.narrow_phase.intersection_graph().raw_graph();
        let nodes = sensed.raw_nodes().len();
        let ends = sensed.raw_edges().iter();
        let ends = ends.map(|edge| [edge.source(), edge.target()].map(ColliderGraphIndex::index));
        of_contacts + self.count_ends(nodes, ends)
    }

    fn count_ends(
        &mut self,
        nodes: usize,
        edges: impl ExactSizeIterator<Item = [usize; 2]>,
    ) -> u64 {
        if edges.len() < FEW {
            return 0;
        }
        self.ends.clear();
        self.ends.resize(nodes, 0);
        for end in edges.flatten() {
            self.ends[end] += 1;
        }
        let counted = self.ends.iter().map(|ends| {
            let ends = u64::from(*ends).min(PAIRS_PER_COLLIDER);
            ends.saturating_sub(FREE)
        });
        counted.sum()
    }
}

fn colliders<'a>(
    world: &'a PhysicsWorld,
    body: &'a RigidBody,
) -> impl Iterator<Item = &'a Collider> {
    let colliders = body.colliders().iter();
    colliders.filter_map(|handle| world.colliders.get(*handle))
}

/// The pose of a collider on its body.
fn within(collider: &Collider) -> RapierPose {
    collider
        .position_wrt_parent()
        .copied()
        .unwrap_or(RapierPose::IDENTITY)
}

/// A bound on the smallest half extent of a shape's boxes in any rotation, metres; 0 if it is not known.
fn thickness(shape: &dyn Shape) -> f32 {
    match shape.as_typed_shape() {
        TypedShape::Ball(ball) => ball.radius,
        TypedShape::Cuboid(cuboid) => cuboid.half_extents.min_element(),
        TypedShape::Capsule(capsule) => capsule.radius,
        TypedShape::Cylinder(cylinder) => cylinder.radius.min(cylinder.half_height),
        _ => 0.0,
    }
}

/// The distance of two unit quaternions, the nearer of each two that are one rotation. A point at a metre from the axis
/// goes less than twice as far, in metres.
fn chord(one: Quat, other: Quat) -> f32 {
    (one - other).length().min((one + other).length())
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
