//! Ways through a step: sensors that are crossed, half-spaces that stop.
//!
//! Rapier tells only what is inside a sensor where a step ends, and by events which fast dynamic bodies went through a
//! fixed one. Here the ways of all bodies are swept against those of all sensors.
//!
//! Rapier sweeps no body against a half-space: a fast one would be deep inside it where the step ends, and come out
//! slowly. Here it is put back to where it came in, with its velocity, as Rapier does with the other fixed solids: the
//! next step begins with the contact.

use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::sync::Mutex;

use glam::{Quat, Vec3};
use rapier3d::geometry::{CollisionEvent, CollisionEventFlags, ContactPair};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::query::sweep_toi::{Sweep, SweepToiStatus, ToiProxy, sweep_time_of_impact};
use rapier3d::parry::query::{
    NonlinearRigidMotion, ShapeCastOptions, cast_shapes_nonlinear, intersection_test,
};
use rapier3d::parry::shape::Shape;
use rapier3d::prelude::{
    Collider, ColliderHandle, ColliderSet, EventHandler, PhysicsWorld, QueryFilter, RigidBody,
    RigidBodyHandle, RigidBodySet, SoftBodySet,
};
use rhumb_reckoning::BodyId;

use super::{RapierEngine, translate};

/// A solid on its way through a step.
pub(super) struct SolidWay<'a> {
    pub(super) start: RapierPose,
    pub(super) end: RapierPose,
    pub(super) shape: &'a dyn Shape,
    /// The body's centre of mass, from the solid: its turn is about it.
    centre: Vec3,
}

impl<'a> SolidWay<'a> {
    /// The way of a solid whose body is at `start` first and at `end` last.
    pub(super) fn new(
        body: &RigidBody,
        solid: &'a Collider,
        start: &RapierPose,
        end: &RapierPose,
    ) -> Self {
        let within = solid.position_wrt_parent().copied().unwrap_or_default();
        Self {
            start: start * within,
            end: end * within,
            shape: solid.shape(),
            centre: within.inverse_transform_point(body.local_center_of_mass()),
        }
    }

    /// The longest way of one of its points by its turn alone, or more, metres.
    fn way_of_turn(&self) -> f32 {
        let ball = self.shape.compute_local_bounding_sphere();
        let radius = ball.radius() + ball.center().distance(self.centre);
        self.start.rotation.angle_between(self.end.rotation) * radius
    }

    /// The share of the way after which two solids are within half of `in_reach`; `None` if they are not before `most`.
    /// It may be negative for two that begin there.
    pub(super) fn meets(&self, other: &SolidWay<'_>, most: f32, in_reach: f32) -> Option<f32> {
        if let (Some(proxy), Some(other_proxy)) = (
            ToiProxy::from_shape(self.shape),
            ToiProxy::from_shape(other.shape),
        ) {
            let sweep = Sweep::from_poses(&self.start, &self.end, self.centre);
            let other_sweep = Sweep::from_poses(&other.start, &other.end, other.centre);
            let slop = in_reach * 0.25;
            let met = sweep_time_of_impact(&proxy, &sweep, &other_proxy, &other_sweep, most, slop);
            if !matches!(met.status, SweepToiStatus::Hit | SweepToiStatus::Failed) {
                return None;
            }
            // At this fraction they overlap by the slop; the contact begins while they are still apart.
            let way = (sweep.c2 - sweep.c1) - (other_sweep.c2 - other_sweep.c1);
            let way = way.length() + self.way_of_turn() + other.way_of_turn();
            return Some(met.fraction - (slop + in_reach * 0.5) / way);
        }
        let options = ShapeCastOptions {
            max_time_of_impact: most,
            target_distance: in_reach * 0.5,
            stop_at_penetration: false,
            compute_impact_geometry_on_penetration: false,
        };
        let met = rapier3d::parry::query::cast_shapes(
            &self.start,
            self.end.translation - self.start.translation,
            self.shape,
            &other.start,
            other.end.translation - other.start.translation,
            other.shape,
            options,
        );
        Some(met.ok().flatten()?.time_of_impact)
    }

    /// True if two solids are within half of `in_reach` somewhere on their ways, turns included.
    pub(super) fn crosses(&self, other: &SolidWay<'_>, in_reach: f32) -> bool {
        let proxies = [self.shape, other.shape].map(ToiProxy::from_shape);
        if proxies.iter().all(Option::is_some) {
            return self.meets(other, 1.0, in_reach).is_some();
        }
        // Cylinders, cones, meshes: the library turns them too, but half-spaces and heights only by their translation.
        let met = cast_shapes_nonlinear(
            &self.motion(),
            self.shape,
            &other.motion(),
            other.shape,
            0.0,
            1.0,
            true,
        );
        match met {
            Ok(met) => met.is_some(),
            Err(_) => self.meets(other, 1.0, in_reach).is_some(),
        }
    }

    /// Its way, in a time of one.
    fn motion(&self) -> NonlinearRigidMotion {
        let centre = |pose: &RapierPose| pose.transform_point(self.centre);
        let turn = self.end.rotation * self.start.rotation.inverse();
        let shorter = if turn.w < 0.0 { -turn } else { turn };
        NonlinearRigidMotion::new(
            self.start,
            self.centre,
            centre(&self.end) - centre(&self.start),
            shorter.to_scaled_axis(),
        )
    }
}

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

/// Share of its thickness that a body has to go in a step to be fast, as for Rapier's own sweep: a slower one meets the
/// half-space as a contact, and its middle stays outside.
const FAST_SHARE: f32 = 0.5;
/// Halvings of the way to the place where a body comes in: to a thousandth of a way of a step.
const HALVINGS: usize = 10;

/// A half-space, by a pose whose y axis points out of it.
struct HalfSpace<'a> {
    handle: RigidBodyHandle,
    solid: &'a Collider,
    pose: RapierPose,
}

impl HalfSpace<'_> {
    /// The lowest point of a solid at a pose above the surface, and the thickness of the solid, metres.
    fn below(&self, solid: &Collider, pose: &RapierPose) -> (f32, f32) {
        let around = solid.shape().compute_aabb(&self.pose.inv_mul(pose));
        (around.mins.y, around.extents().min_element())
    }
}

impl RapierEngine {
    /// Keeps in mind whether a body is a half-space.
    pub(super) fn note_half_space(&mut self, id: BodyId, is_one: bool) {
        if is_one {
            self.half_spaces.insert(id);
        } else {
            self.half_spaces.remove(&id);
        }
    }

    /// Where the bodies are that may move in the next part of a step; none if there is no half-space.
    pub(super) fn half_space_starts(&self) -> Vec<(RigidBodyHandle, RapierPose)> {
        if self.half_spaces.is_empty() {
            return Vec::new();
        }
        let movers = self.stirred.iter().filter_map(|place| {
            let body = self.world.bodies.get(place.handle)?;
            let moves = body.is_dynamic() && body.is_enabled();
            moves.then(|| (place.handle, *body.position()))
        });
        movers.collect()
    }

    /// Puts bodies that went into a half-space within a part of a step, of so many seconds, back to where they came in.
    pub(super) fn stop_at_half_spaces(
        &mut self,
        starts: &[(RigidBodyHandle, RapierPose)],
        seconds: f32,
    ) {
        if self.half_spaces.is_empty() {
            return;
        }
        let half_spaces = self.half_spaces();
        let stopped: Vec<_> = starts
            .iter()
            .copied()
            .chain(self.woken_starts(seconds))
            .filter_map(|(handle, start)| {
                let body = self.world.bodies.get(handle)?;
                let way = Sweep::from_poses(&start, body.position(), body.local_center_of_mass());
                let mut share = 1.0;
                for half_space in &half_spaces {
                    share = self.share_outside(half_space, (handle, body), &way, share);
                }
                (share < 1.0).then(|| (handle, way.transform_at(share)))
            })
            .collect();
        for (handle, pose) in stopped {
            if let Some(body) = self.world.bodies.get_mut(handle) {
                body.set_position(pose, false);
            }
        }
    }

    /// The bodies that another one woke within a part of a step, and where they lay: on the line that their velocities tell.
    fn woken_starts(&self, seconds: f32) -> impl Iterator<Item = (RigidBodyHandle, RapierPose)> {
        let stirred = |id: BodyId| self.stirred.binary_search_by_key(&id, |place| place.id);
        let active = self.world.active_bodies();
        let woken = active
            .filter(move |(_, body)| body.is_dynamic() && stirred(translate::id(body)).is_err());
        woken.map(move |(handle, body)| {
            let mut start = *body.position();
            start.translation -= body.linvel() * seconds;
            (handle, start)
        })
    }

    fn half_spaces(&self) -> Vec<HalfSpace<'_>> {
        let all = self.half_spaces.iter().filter_map(|id| {
            let handle = self.place(*id)?.handle;
            let body = self.world.bodies.get(handle)?;
            let solid = self.world.colliders.get(*body.colliders().first()?)?;
            let normal = solid.shape().as_halfspace()?.normal;
            let upright = Quat::from_rotation_arc(Vec3::Y, normal);
            let pose = RapierPose::from_parts(
                solid.position().translation,
                solid.position().rotation * upright,
            );
            let is_solid = solid.is_enabled() && !solid.is_sensor();
            is_solid.then_some(HalfSpace {
                handle,
                solid,
                pose,
            })
        });
        all.collect()
    }

    /// The share of a way after which a body comes into a half-space; `most` if it does not before.
    fn share_outside(
        &self,
        half_space: &HalfSpace<'_>,
        (handle, body): (RigidBodyHandle, &RigidBody),
        way: &Sweep,
        most: f32,
    ) -> f32 {
        let mut share = most;
        for solid in body.colliders() {
            let Some(solid) = self.world.colliders.get(*solid) else {
                continue;
            };
            let within = solid.position_wrt_parent().copied().unwrap_or_default();
            let at = |share: f32| half_space.below(solid, &(way.transform_at(share) * within));
            let ((begin, thickness), (end, _)) = (at(0.0), at(share));
            let comes_in = begin >= 0.0 && end < 0.0 && begin - end > thickness * FAST_SHARE;
            let touches = comes_in
                && solid.is_enabled()
                && !solid.is_sensor()
                && (solid.collision_groups()).test(half_space.solid.collision_groups())
                && !self.are_apart(handle, half_space.handle);
            if touches {
                share = last_outside(share, |share| at(share).0 >= 0.0);
            }
        }
        share
    }
}

/// The greatest share below `inside` that is known to be outside.
fn last_outside(inside: f32, is_outside: impl Fn(f32) -> bool) -> f32 {
    let (mut outside, mut inside) = (0.0, inside);
    for _ in 0..HALVINGS {
        let middle = f32::midpoint(outside, inside);
        if is_outside(middle) {
            outside = middle;
        } else {
            inside = middle;
        }
    }
    outside
}
