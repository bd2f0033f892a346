//! Steps a Rapier world, in parts where swept bodies meet moving ones.
//!
//! Rapier sweeps a body against others where the step ends, and never two swept bodies against each other. Here the step
//! ends early where a swept body meets one that moves fast or is swept too, and goes on from there: the next part begins
//! with their contact. Without such a meeting a step is one step of Rapier.

use std::collections::BTreeSet;
use std::sync::Mutex;

use glam::Vec3;
use rapier3d::geometry::{CollisionEvent, CollisionEventFlags, ContactPair};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::query::ShapeCastOptions;
use rapier3d::parry::query::sweep_toi::{Sweep, SweepToiStatus, ToiProxy, sweep_time_of_impact};
use rapier3d::prelude::{
    Collider, ColliderHandle, ColliderSet, EventHandler, PhysicsWorld, RigidBody, RigidBodyHandle,
    RigidBodySet, SoftBodySet,
};
use rhumb_protocol::message::RemovalCause;
use rhumb_reckoning::BodyId;

use super::{RapierEngine, translate};

/// Most parts of a step; the last one is what remains.
const PARTS_MAX: usize = 16;

/// A body that moves by less than this share of its thickness is where a sweep against its end finds it.
const SLOW_SHARE: f32 = 0.25;

/// A body on its way through a step.
struct Mover<'a> {
    handle: RigidBodyHandle,
    body: &'a RigidBody,
    end: RapierPose,
    /// Around all its solids, on their whole way.
    around: Aabb,
}

impl RapierEngine {
    /// Steps the world once, and notes the sensors that bodies crossed within the step.
    pub(super) fn step_world(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        let crossings = Crossings::default();
        let whole = self.world.integration_parameters.dt;
        let mut left = whole;
        let ways = self.kinematic_ways();
        for _ in 1..PARTS_MAX {
            let Some(share) = self.first_meeting(left) else {
                break;
            };
            let part = left * share;
            self.step_part(&crossings, part, &ways, 1.0 - (left - part) / whole);
            self.discard_quarantined(lost);
            left -= part;
        }
        self.step_part(&crossings, left, &ways, 1.0);
        self.discard_quarantined(lost);
        self.world.integration_parameters.dt = whole;
        self.crossed = crossings.pairs(&self.world);
    }

    /// Steps a part of a step. `share`: of the way of kinematic bodies at its end.
    fn step_part(
        &mut self,
        crossings: &Crossings,
        part: f32,
        ways: &[(RigidBodyHandle, Sweep)],
        share: f32,
    ) {
        for (handle, way) in ways {
            if let Some(body) = self.world.bodies.get_mut(*handle) {
                let next = match share < 1.0 {
                    true => way.transform_at(share),
                    false => way.final_transform(),
                };
                body.set_next_kinematic_position(next);
            }
        }
        self.world.integration_parameters.dt = part;
        self.world.step_with_events(&(), crossings);
    }

    /// The ways of kinematic bodies in this step, if it may have parts.
    fn kinematic_ways(&self) -> Vec<(RigidBodyHandle, Sweep)> {
        if self.swept.is_empty() {
            return Vec::new();
        }
        let moving = self.world.bodies.iter().filter(|(_, body)| {
            body.is_kinematic() && body.is_enabled() && body.next_position() != body.position()
        });
        let way =
            |body: &RigidBody| Sweep::from_poses(body.position(), body.next_position(), Vec3::ZERO);
        moving.map(|(handle, body)| (handle, way(body))).collect()
    }

    /// The share of the rest of a step after which the first two bodies meet that Rapier would let pass.
    fn first_meeting(&self, left: f32) -> Option<f32> {
        if self.swept.is_empty() {
            return None;
        }
        let movers = self.movers(left);
        let in_reach = self.world.integration_parameters.prediction_distance() * 0.5;
        let mut first: Option<f32> = None;
        for (place, mover) in movers.iter().enumerate() {
            if !mover.body.is_ccd_enabled() {
                continue;
            }
            for (other_place, other) in movers.iter().enumerate() {
                let is_twice = other.body.is_ccd_enabled() && other_place <= place;
                if is_twice
                    || other_place == place
                    || !mover.around.intersects(&other.around)
                    || self.are_apart(mover.handle, other.handle)
                {
                    continue;
                }
                let most = first.unwrap_or(1.0);
                let met = self.meeting(mover, other, most, in_reach);
                first = met.filter(|share| *share < most).or(first);
            }
        }
        first
    }

    /// The swept bodies, and the others that move fast for their size.
    fn movers(&self, left: f32) -> Vec<Mover<'_>> {
        let bodies = self.world.active_bodies();
        let movers = bodies.filter_map(|(handle, body)| {
            let end = match body.is_kinematic() {
                true => *body.next_position(),
                false => body.predict_position_using_velocity_and_forces(left),
            };
            let (mut around, mut thickness) = (None::<Aabb>, f32::MAX);
            for collider in body.colliders() {
                let collider = self.world.colliders.get(*collider)?;
                if collider.is_sensor() {
                    continue;
                }
                let within = collider.position_wrt_parent().copied().unwrap_or_default();
                let shape = collider.shape();
                let ways = [body.position(), &end].map(|pose| shape.compute_aabb(&(pose * within)));
                let both = ways[0].merged(&ways[1]);
                thickness = thickness.min(ways[0].extents().min_element());
                around = Some(around.map_or(both, |around| around.merged(&both)));
            }
            let way = (end.translation - body.translation()).length();
            let is_fast = way > thickness * SLOW_SHARE;
            let mover = Mover {
                handle,
                body,
                end,
                around: around?,
            };
            (is_fast || body.is_ccd_enabled()).then_some(mover)
        });
        movers.collect()
    }

    /// True if a joint keeps two bodies from touching.
    fn are_apart(&self, one: RigidBodyHandle, other: RigidBodyHandle) -> bool {
        let mut joints = self.world.impulse_joints.joints_between(one, other);
        joints.any(|(_, joint)| !joint.data.contacts_enabled())
    }

    /// The share of the rest of a step after which two bodies meet; `None` if they do not before `most`, or touch now.
    fn meeting(&self, one: &Mover<'_>, other: &Mover<'_>, most: f32, in_reach: f32) -> Option<f32> {
        let colliders = |mover: &Mover<'_>| {
            let handles = mover.body.colliders().iter();
            let all: Vec<_> = handles
                .filter_map(|handle| self.world.colliders.get(*handle))
                .filter(|collider| collider.is_enabled() && !collider.is_sensor())
                .collect();
            all
        };
        let others = colliders(other);
        let mut first: Option<f32> = None;
        for solid in colliders(one) {
            for other_solid in &others {
                let groups = solid.collision_groups();
                if !groups.test(other_solid.collision_groups()) {
                    continue;
                }
                let limit = first.unwrap_or(most);
                let pair = [(one, solid), (other, *other_solid)];
                let met = meeting_of_solids(pair, limit, in_reach);
                first = met.filter(|share| *share < limit).or(first);
            }
        }
        first
    }
}

/// As [`RapierEngine::meeting`], of one solid of each body.
fn meeting_of_solids(pair: [(&Mover<'_>, &Collider); 2], most: f32, in_reach: f32) -> Option<f32> {
    let poses = pair.map(|(mover, collider)| {
        let within = collider.position_wrt_parent().copied().unwrap_or_default();
        (mover.body.position() * within, mover.end * within)
    });
    let centres = pair.map(|(mover, collider)| {
        let within = collider.position_wrt_parent().copied().unwrap_or_default();
        within.inverse_transform_point(mover.body.local_center_of_mass())
    });
    let [one, other] = pair.map(|(_, collider)| collider.shape());
    let [(start, end), (other_start, other_end)] = poses;
    let distance = rapier3d::parry::query::distance(&start, one, &other_start, other);
    if distance.is_ok_and(|apart| apart.distance <= in_reach) {
        // They touch in the next part by themselves.
        return None;
    }
    if let (Some(proxy), Some(other_proxy)) =
        (ToiProxy::from_shape(one), ToiProxy::from_shape(other))
    {
        let sweep = Sweep::from_poses(&start, &end, centres[0]);
        let other_sweep = Sweep::from_poses(&other_start, &other_end, centres[1]);
        let slop = in_reach * 0.25;
        let met = sweep_time_of_impact(&proxy, &sweep, &other_proxy, &other_sweep, most, slop);
        if !matches!(met.status, SweepToiStatus::Hit | SweepToiStatus::Failed) {
            return None;
        }
        // That is when they overlap by the slop; the contact begins while they are still apart.
        let way = (sweep.c2 - sweep.c1) - (other_sweep.c2 - other_sweep.c1);
        let share = met.fraction - (slop + in_reach * 0.5) / way.length();
        return (share > 0.0).then_some(share);
    }
    let options = ShapeCastOptions {
        max_time_of_impact: most,
        target_distance: in_reach * 0.5,
        stop_at_penetration: false,
        compute_impact_geometry_on_penetration: false,
    };
    let ways = poses.map(|(start, end)| end.translation - start.translation);
    let met = rapier3d::parry::query::cast_shapes(
        &start,
        ways[0],
        one,
        &other_start,
        ways[1],
        other,
        options,
    );
    let share = met.ok().flatten()?.time_of_impact;
    (share > 0.0).then_some(share)
}

/// Sensors that were entered and left within one step.
#[derive(Default)]
struct Crossings {
    seen: Mutex<Vec<(ColliderHandle, ColliderHandle, Change)>>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Change {
    Entered,
    Left,
}

impl Crossings {
    /// Each sensor that was entered and left, with the body that did.
    fn pairs(self, world: &PhysicsWorld) -> BTreeSet<(BodyId, BodyId)> {
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
