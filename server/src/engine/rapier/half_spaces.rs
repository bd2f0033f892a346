//! Fast bodies stop at half-spaces.
//!
//! Rapier sweeps no body against a half-space: a fast one would be deep inside it where the step ends, and come out
//! slowly. Here it is put back to where it came in, with its velocity, as Rapier does with the other fixed solids: the
//! next step begins with the contact.

use glam::{Quat, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::query::sweep_toi::Sweep;
use rapier3d::prelude::{Collider, RigidBody, RigidBodyHandle};
use rhumb_reckoning::BodyId;

use super::{RapierEngine, translate};

/// Share of its thickness that a body has to go in a step to be fast, as for Rapier's own sweep: a slower one meets the
/// half-space as a contact, and its middle stays outside.
const SLOW_SHARE: f32 = 0.5;
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
            let comes_in = begin >= 0.0 && end < 0.0 && begin - end > thickness * SLOW_SHARE;
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
