//! Sensors that bodies go through within a step.
//!
//! Rapier tells only what is inside a sensor where a step ends, and by events which fast dynamic bodies went through a
//! fixed one. Here the ways of all bodies are swept against those of all sensors.

use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::sync::Mutex;

use rapier3d::geometry::{CollisionEvent, CollisionEventFlags, ContactPair};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::query::intersection_test;
use rapier3d::prelude::{
    Collider, ColliderHandle, ColliderSet, EventHandler, PhysicsWorld, QueryFilter, RigidBody,
    RigidBodyHandle, RigidBodySet, SoftBodySet,
};
use rhumb_reckoning::BodyId;

use super::solid_way::SolidWay;
use super::{RapierEngine, translate};

/// Reach of the sweep of a sensor, metres: an overlap of a quarter of it is found.
const REACH: f32 = 4e-4;

/// Share of the thickness of a body by which its fastest point moves at least, if the body is to pass a fixed sensor
/// between two steps: a slower one can at most graze an edge, by a sixteenth of its thickness.
const SLOW_SHARE: f32 = 0.25;

/// A body that has gone its way through a step.
struct Passed<'a> {
    body: &'a RigidBody,
    start: RapierPose,
    /// Around its solids where the step began and where it ended.
    around: Aabb,
    /// True if its points moved far for its thickness.
    is_fast: bool,
}

impl RapierEngine {
    /// Poses of the bodies at the begin of a step, those that sleep too, as they may wake and move in it; none if there
    /// is no sensor. They are in the buffer of the step before.
    pub(super) fn sensor_starts(&mut self) -> Vec<(RigidBodyHandle, RapierPose)> {
        let mut starts = mem::take(&mut self.sensor_starts);
        starts.clear();
        if self.sensors.is_empty() {
            return starts;
        }
        let bodies = self.world.bodies.iter();
        let movable = bodies.filter(|(_, body)| !body.is_fixed() && body.is_enabled());
        starts.extend(movable.map(|(handle, body)| (handle, *body.position())));
        starts
    }

    /// Adds what went through a sensor, and neither began nor ended inside it.
    pub(super) fn note_crossed_on_the_way(&mut self, starts: Vec<(RigidBodyHandle, RapierPose)>) {
        let crossed = self.crossed_on_the_way(&starts);
        self.crossed.extend(crossed);
        self.sensor_starts = starts;
    }

    fn crossed_on_the_way(
        &self,
        starts: &[(RigidBodyHandle, RapierPose)],
    ) -> BTreeSet<(BodyId, BodyId)> {
        let has_moved = |(handle, start): &&(RigidBodyHandle, RapierPose)| {
            let body = self.world.bodies.get(*handle);
            body.is_some_and(|body| start != body.position())
        };
        // Most bodies rest, and cost no more than this.
        let movers: BTreeMap<BodyId, Passed<'_>> = starts
            .iter()
            .filter(has_moved)
            .filter_map(|(handle, start)| self.passed(*handle, *start))
            .map(|passed| (translate::id(passed.body), passed))
            .collect();
        let mut crossed = BTreeSet::new();
        if movers.is_empty() {
            return crossed;
        }
        for id in &self.sensors {
            let Some(slot) = self.place(*id) else {
                continue;
            };
            let moves = movers.get(id);
            let still = match moves {
                Some(_) => None,
                None => self.standing(slot.handle),
            };
            let Some(sensor) = moves.or(still.as_ref()) else {
                continue;
            };
            let near = movers.iter().filter(|(other, passed)| {
                *other != id
                    && (passed.is_fast || moves.is_some())
                    && passed.around.intersects(&sensor.around)
            });
            let through = near.filter(|(_, passed)| self.goes_through(sensor, passed));
            crossed.extend(through.map(|(other, _)| (*id, *other)));
            if moves.is_some() {
                let near = self.standing_near(sensor, &movers);
                let through = near
                    .iter()
                    .filter(|(_, passed)| self.goes_through(sensor, passed));
                crossed.extend(through.map(|(other, _)| (*id, *other)));
            }
        }
        crossed
    }

    /// The bodies on the way of a sensor that did not move in the step; they may sleep, or be fixed.
    fn standing_near<'a>(
        &'a self,
        sensor: &Passed<'_>,
        movers: &BTreeMap<BodyId, Passed<'_>>,
    ) -> BTreeMap<BodyId, Passed<'a>> {
        let queries = self
            .world
            .query_pipeline_with_filter(QueryFilter::default());
        let near = queries.intersect_aabb_conservative(sensor.around);
        let standing = near.filter_map(|(_, solid)| {
            let handle = solid.parent()?;
            let passed = self.standing(handle)?;
            let id = translate::id(passed.body);
            (!movers.contains_key(&id)).then_some((id, passed))
        });
        standing.collect()
    }

    fn standing(&self, handle: RigidBodyHandle) -> Option<Passed<'_>> {
        let body = self.world.bodies.get(handle)?;
        self.passed(handle, *body.position())
    }

    fn passed(&self, handle: RigidBodyHandle, start: RapierPose) -> Option<Passed<'_>> {
        let body = self.world.bodies.get(handle)?;
        let end = body.position();
        let (mut around, mut thickness) = (None::<Aabb>, f32::MAX);
        for solid in body.colliders() {
            let solid = self.world.colliders.get(*solid)?;
            let within = solid.position_wrt_parent().copied().unwrap_or_default();
            let ways = [start, *end].map(|pose| solid.shape().compute_aabb(&(pose * within)));
            let both = ways[0].merged(&ways[1]);
            thickness = thickness.min(solid.shape().ccd_thickness());
            around = Some(around.map_or(both, |around| around.merged(&both)));
        }
        let around = around?;
        let reach = around.half_extents().length();
        let turn = start.rotation.angle_between(end.rotation);
        let moved = (end.translation - start.translation).length() + turn * reach;
        Some(Passed {
            body,
            start,
            around,
            is_fast: moved > thickness * SLOW_SHARE,
        })
    }

    /// True if a body went through a sensor on their ways, and touched it at neither end.
    fn goes_through(&self, sensor: &Passed<'_>, other: &Passed<'_>) -> bool {
        let mut is_met = false;
        for zone in self
            .solids_of(sensor.body)
            .filter(|solid| solid.is_sensor())
        {
            let zone_way = SolidWay::new(sensor.body, zone, &sensor.start, sensor.body.position());
            for solid in self.solids_of(other.body) {
                if !zone.collision_groups().test(solid.collision_groups()) {
                    continue;
                }
                let way = SolidWay::new(other.body, solid, &other.start, other.body.position());
                let ends = [(&zone_way.start, &way.start), (&zone_way.end, &way.end)];
                let touches = |(one, other)| {
                    let met = intersection_test(one, zone.shape(), other, solid.shape());
                    met.is_ok_and(|met| met.intersecting)
                };
                if ends.into_iter().any(touches) {
                    return false;
                }
                is_met = is_met || zone_way.crosses(&way, REACH);
            }
        }
        is_met
    }

    fn solids_of<'a>(&'a self, body: &'a RigidBody) -> impl Iterator<Item = &'a Collider> {
        let solids = body.colliders().iter();
        solids
            .filter_map(|handle| self.world.colliders.get(*handle))
            .filter(|solid| solid.is_enabled())
    }
}

/// Sensors that were entered and left within one step.
#[derive(Default)]
pub(super) struct Crossings {
    seen: Mutex<Vec<(ColliderHandle, ColliderHandle, Change)>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Change {
    Entered,
    Left,
}

impl Crossings {
    /// Each sensor that was entered and left, with the body that did.
    pub(super) fn pairs(self, world: &PhysicsWorld) -> BTreeSet<(BodyId, BodyId)> {
        let seen = self.seen.into_inner().unwrap_or_default();
        let mut pairs = BTreeSet::new();
        for (place, (one, other, change)) in seen.iter().enumerate() {
            let left = (*one, *other, Change::Left);
            if *change != Change::Entered || !seen[place..].contains(&left) {
                continue;
            }
            let solids = [*one, *other].map(|handle| world.colliders.get(handle));
            let [Some(one), Some(other)] = solids else {
                continue;
            };
            let owner = |solid: &Collider| world.bodies.get(solid.parent()?).map(translate::id);
            let (Some(first), Some(second)) = (owner(one), owner(other)) else {
                continue;
            };
            if one.is_sensor() {
                pairs.insert((first, second));
            }
            if other.is_sensor() {
                pairs.insert((second, first));
            }
        }
        pairs
    }
}

impl EventHandler for Crossings {
    fn handle_collision_event(
        &self,
        _: &RigidBodySet,
        _: &ColliderSet,
        event: CollisionEvent,
        _: Option<&ContactPair>,
    ) {
        let (one, other, flags, change) = match event {
            CollisionEvent::Started(one, other, flags) => (one, other, flags, Change::Entered),
            CollisionEvent::Stopped(one, other, flags) => (one, other, flags, Change::Left),
        };
        if flags.contains(CollisionEventFlags::SENSOR)
            && let Ok(mut seen) = self.seen.lock()
        {
            seen.push((one, other, change));
        }
    }

    fn handle_contact_force_event(
        &self,
        _: f32,
        _: &RigidBodySet,
        _: &ColliderSet,
        _: &ContactPair,
        _: f32,
    ) {
    }

    fn handle_soft_body_tear_event(
        &self,
        _: &SoftBodySet,
        _: &rapier3d::dynamics::SoftBodyTearEvent,
    ) {
    }
}
