//! A solid on its way through a step, and when two of them meet.

use glam::Vec3;
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::query::sweep_toi::{Sweep, SweepToiStatus, ToiProxy, sweep_time_of_impact};
use rapier3d::parry::query::{NonlinearRigidMotion, ShapeCastOptions, cast_shapes_nonlinear};
use rapier3d::parry::shape::Shape;
use rapier3d::prelude::{Collider, RigidBody};

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
