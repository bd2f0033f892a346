//! Steps a Rapier world: kinematic bodies first, then all, in parts if needed.
//!
//! A character goes as far as the world lets it; a kinematic body that is none goes where its commands say.
//!
//! Rapier sweeps a body against others where the step ends, and never two swept bodies against each other. Here the step
//! ends early where a swept body meets one that moves fast or is swept too, and continues from there: the next part begins
//! with their contact. Without such a meeting a step is one step of Rapier.

use core::f32::consts::FRAC_PI_2;
use std::collections::BTreeSet;

use glam::Vec3;
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d::parry::query::sweep_toi::Sweep;
use rapier3d::prelude::{Collider, QueryFilter, RigidBody, RigidBodyHandle};
use rhumb_protocol::message::RemovalCause;
use rhumb_reckoning::{BodyId, Pose};

use super::crossing::{Crossings, SolidWay};
use super::{BodySlot, RapierEngine, translate};
use crate::engine::interface::EngineFault;
use crate::engine::kinematic_target::KinematicStep;

/// Most parts of a step; the last one is what remains.
const PARTS_MAX: usize = 16;

/// A body that moves by less than this share of its thickness is where a sweep against its end finds it.
const SLOW_SHARE: f32 = 0.25;

/// The plan of a part of a step.
#[derive(Default)]
struct Plan {
    /// The share of the rest of the step after which the first two bodies meet that Rapier would let pass.
    share: Option<f32>,
    /// Swept bodies on the way of fast ones. Rapier would sweep them against the places where those end, which may be
    /// in front of them.
    own: BTreeSet<BodyId>,
    /// Bodies that are met in their sleep: Rapier would wake them a step too late.
    woken: Vec<RigidBodyHandle>,
}

/// A body on its way through a step.
struct Mover<'a> {
    handle: RigidBodyHandle,
    body: &'a RigidBody,
    is_swept: bool,
    end: RapierPose,
    /// Around all its solids, on their whole way.
    around: Aabb,
}

impl Mover<'_> {
    /// The longest way of one of its points, or more, metres.
    fn way(&self) -> f32 {
        let moved = (self.end.translation - self.body.translation()).length();
        moved + self.turn() * self.around.half_extents().length()
    }

    /// The angle by which it turns, radians.
    fn turn(&self) -> f32 {
        self.body.rotation().angle_between(self.end.rotation)
    }
}

impl RapierEngine {
    /// Moves the characters, but not those whose commands put them elsewhere.
    pub(super) fn walk(&mut self) {
        self.characters.begin_step();
        for id in self.characters.ids() {
            let Some(place) = self.place(id) else {
                continue;
            };
            if self.body(place).is_none_or(|body| !body.is_enabled()) {
                continue;
            }
            let target = self.kinematic_targets.get_mut(&id);
            let kept = target.as_ref().map(|target| target.keeps());
            if kept == Some(None) {
                self.characters.halt(id);
                continue;
            }
            let twist = kept.flatten().unwrap_or_default();
            let velocity = translate::narrow_twist(&twist).0;
            let walker = (id, place.handle);
            let moved = self.characters.advance(&mut self.world, walker, velocity);
            let body = &mut self.world.bodies[place.handle];
            let mut next = *body.position();
            next.translation += moved;
            if let Some(target) = target {
                let there = Pose {
                    position: next.translation.as_dvec3(),
                    rotation: target.turned(self.integrator),
                };
                target.arrive(there);
                next = translate::nearest(translate::narrow(&there), *body.rotation());
            }
            body.set_next_kinematic_position(next);
        }
    }

    /// Moves the kinematic bodies that are no characters, and the characters that commands put elsewhere.
    pub(super) fn move_kinematic(&mut self) {
        let integrator = self.integrator;
        self.kinematic_targets
            .retain(|_, kinematic_target| kinematic_target.is_needed(integrator));
        let mut jumped = Vec::new();
        for (id, kinematic_target) in &mut self.kinematic_targets {
            if self.characters.contains(*id) && kinematic_target.keeps().is_some() {
                continue;
            }
            let is_moving = kinematic_target.is_moving();
            let step = kinematic_target.advance(integrator);
            let place = self.places.get(id.index() as usize).copied().flatten();
            let body = place.and_then(|place| self.world.bodies.get_mut(place.handle));
            let Some((place, body)) = place.zip(body).filter(|_| is_moving) else {
                continue;
            };
            let next = translate::narrow(&step.pose());
            let next = translate::nearest(next, *body.rotation());
            if matches!(step, KinematicStep::Jump(_)) {
                jumped.push(place.handle);
                body.set_position(next, true);
            }
            body.set_next_kinematic_position(next);
        }
        for handle in jumped {
            translate::wake_touching(&mut self.world, handle);
        }
    }

    /// Steps the world once, and notes the sensors that bodies crossed within the step. A crowd between two parts is a fault.
    pub(super) fn step_world(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) {
        let crossings = Crossings::default();
        let whole = self.world.integration_parameters.dt;
        let mut left = whole;
        let ways = self.kinematic_ways();
        let starts = self.sensor_starts();
        for number in 1..=PARTS_MAX {
            self.lead(&ways, 1.0);
            let plan = self.plan(left);
            self.sweep_others(&plan.own);
            for handle in plan.woken {
                if let Some(body) = self.world.bodies.get_mut(handle) {
                    body.wake_up(true);
                }
            }
            let share = plan.share.filter(|_| number < PARTS_MAX);
            let part = share.map_or(left, |share| left * share);
            let way = share.map_or(1.0, |_| 1.0 - (left - part) / whole);
            self.lead(&ways, way);
            self.world.integration_parameters.dt = part;
            let half_space_starts = self.half_space_starts();
            self.world.step_with_events(&(), &crossings);
            self.discard_quarantined(lost);
            self.stop_at_half_spaces(&half_space_starts, part);
            left -= part;
            if share.is_none() {
                break;
            }
            let active = self.world.active_bodies();
            let active =
                active.map(|(handle, body)| (translate::id(body), handle, *body.position()));
            self.crowding.look(&self.world, active);
            if self.crowding.is_beyond() {
                self.fault = Some(EngineFault::Crowded);
                return;
            }
        }
        self.sweep_others(&BTreeSet::new());
        self.world.integration_parameters.dt = whole;
        self.crossed = crossings.pairs(&self.world);
        self.note_crossed_on_the_way(starts);
    }

    /// Leaves all swept bodies but these to Rapier's own sweep.
    fn sweep_others(&mut self, own: &BTreeSet<BodyId>) {
        for id in &self.swept {
            let slot = self.places.get(id.index() as usize).copied().flatten();
            if let Some(body) = slot.and_then(|slot| self.world.bodies.get_mut(slot.handle)) {
                let is_on = !own.contains(id);
                if body.is_ccd_enabled() != is_on {
                    body.enable_ccd(is_on);
                }
            }
        }
    }

    /// Sends kinematic bodies to this share of their ways.
    fn lead(&mut self, ways: &[(RigidBodyHandle, Sweep)], share: f32) {
        for (handle, way) in ways {
            if let Some(body) = self.world.bodies.get_mut(*handle) {
                let next = match share < 1.0 {
                    true => way.transform_at(share),
                    false => way.final_transform(),
                };
                body.set_next_kinematic_position(next);
            }
        }
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

    /// Finds what the rest of a step needs.
    fn plan(&self, left: f32) -> Plan {
        let mut plan = Plan::default();
        if self.swept.is_empty() {
            return plan;
        }
        let movers = self.movers(left);
        let in_reach = self.world.integration_parameters.prediction_distance() * 0.5;
        for (place, mover) in movers.iter().enumerate() {
            let may_meet = |other: &Mover<'_>| {
                other.handle != mover.handle
                    && mover.around.intersects(&other.around)
                    && !self.are_apart(mover.handle, other.handle)
            };
            // Rapier sweeps dynamic bodies against slow ones itself, and no kinematic body.
            let sweeps = mover.body.is_kinematic() || movers.iter().any(may_meet);
            if !mover.is_swept || !sweeps {
                continue;
            }
            plan.own.insert(translate::id(mover.body));
            let is_once = |(other, mover): &(usize, &Mover<'_>)| !mover.is_swept || *other > place;
            let fast = movers.iter().enumerate().filter(is_once);
            let slow = self.slow_bodies(mover, &movers, left);
            let all = fast.map(|(_, other)| other).chain(&slow);
            for other in all.filter(|other| may_meet(other)) {
                let most = plan.share.unwrap_or(1.0);
                let met = self.meeting(mover, other, most, in_reach);
                if met.is_some() && other.body.is_sleeping() {
                    plan.woken.push(other.handle);
                }
                plan.share = met.filter(|share| *share < most).or(plan.share);
            }
        }
        plan
    }

    /// The bodies beside the movers on the way of one of these; they may sleep.
    fn slow_bodies<'a>(
        &'a self,
        mover: &Mover<'_>,
        movers: &[Mover<'_>],
        left: f32,
    ) -> Vec<Mover<'a>> {
        let queries = self
            .world
            .query_pipeline_with_filter(QueryFilter::exclude_fixed());
        let near = queries.intersect_aabb_conservative(mover.around);
        let mut handles: Vec<_> = near.filter_map(|(_, solid)| solid.parent()).collect();
        handles.sort_unstable_by_key(|handle| handle.into_raw_parts());
        handles.dedup();
        handles.retain(|handle| movers.iter().all(|mover| mover.handle != *handle));
        let bodies = handles.into_iter().filter_map(|handle| {
            let body = self.world.bodies.get(handle)?;
            self.mover((handle, body), left).map(|(mover, _)| mover)
        });
        bodies.collect()
    }

    /// The swept bodies, the others that move fast for their size, and those that Rapier does not know before its step.
    fn movers(&self, left: f32) -> Vec<Mover<'_>> {
        let active: Vec<_> = self.world.active_bodies().collect();
        let known: BTreeSet<_> = active
            .iter()
            .map(|(handle, _)| handle.into_raw_parts())
            .collect();
        let movers = active.into_iter().filter_map(|active| {
            let (mover, thickness) = self.mover(active, left)?;
            let is_fast = mover.way() > thickness * SLOW_SHARE;
            (is_fast || mover.is_swept).then_some(mover)
        });
        let is_new = |place: &&BodySlot| !known.contains(&place.handle.into_raw_parts());
        let new = self.stirred.iter().filter(is_new).filter_map(|place| {
            let body = self.world.bodies.get(place.handle)?;
            let moves = body.is_enabled() && !body.is_fixed() && !body.is_sleeping();
            let (mover, _) = moves.then(|| self.mover((place.handle, body), left))??;
            Some(mover)
        });
        movers.chain(new).collect()
    }

    /// A body on its way, and the thickness of its thinnest solid; `None` for one that nothing can meet.
    fn mover<'a>(
        &'a self,
        (handle, body): (RigidBodyHandle, &'a RigidBody),
        left: f32,
    ) -> Option<(Mover<'a>, f32)> {
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
        let mut mover = Mover {
            handle,
            body,
            is_swept: self.swept.contains(&translate::id(body)),
            end,
            around: around?,
        };
        // A corner is farther out in the middle of a turn than at its ends.
        let bulge = 1.0 - (mover.turn() * 0.5).min(FRAC_PI_2).cos();
        let radius = mover.around.half_extents().length();
        // Of a half-space, the product is no number.
        mover.around = mover.around.loosened((bulge * radius).max(0.0));
        Some((mover, thickness))
    }

    /// True if a joint keeps two bodies from touching.
    pub(super) fn are_apart(&self, one: RigidBodyHandle, other: RigidBodyHandle) -> bool {
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
    let [one, other] = pair
        .map(|(mover, solid)| SolidWay::new(mover.body, solid, mover.body.position(), &mover.end));
    let distance =
        rapier3d::parry::query::distance(&one.start, one.shape, &other.start, other.shape);
    if distance.is_ok_and(|apart| apart.distance <= in_reach) {
        // They touch in the next part by themselves.
        return None;
    }
    one.meets(&other, most, in_reach)
        .filter(|share| *share > 0.0)
}
