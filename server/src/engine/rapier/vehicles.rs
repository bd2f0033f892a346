//! Vehicles of a Rapier world, by id.
//!
//! Each step pushes every awake chassis by its wheels, before the engine steps. A chassis that sleeps is left alone
//! until the ground below a wheel changes.

use std::collections::BTreeMap;

use glam::Vec3;
use rapier3d::control::{DynamicRayCastVehicleController, Wheel as RapierWheel, WheelTuning};
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    ColliderHandle, InteractionGroups, PhysicsWorld, QueryFilter, Ray, RigidBody, RigidBodyHandle,
};
use rhumb_protocol::scene::{Vehicle, WheelInput};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;
use rhumb_solids::nearest_hit;

use super::body::share_within;
use crate::engine::interface::{SPEED_MAX, SPIN_MAX};

/// The vehicles.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierVehicles {
    controllers: BTreeMap<BodyId, DynamicRayCastVehicleController>,
}

/// Speed of the ground below a wheel that wakes a chassis, m/s.
const GROUND_SPEED: f32 = 1e-3;
/// Change of a suspension's length that wakes a chassis, metres.
const GROUND_CHANGE: f32 = 0.01;

impl RapierVehicles {
    /// Gives a body wheels, in place of those before, and wakes it.
    pub(super) fn set(
        &mut self,
        world: &mut PhysicsWorld,
        (id, chassis): (BodyId, RigidBodyHandle),
        vehicle: &Vehicle,
    ) {
        self.controllers.insert(id, controller(chassis, vehicle));
        wake(world, chassis);
    }

    /// Removes the wheels of a body, if it has any, and wakes it.
    pub(super) fn remove(&mut self, world: &mut PhysicsWorld, id: BodyId) {
        if let Some(controller) = self.controllers.remove(&id) {
            wake(world, controller.chassis);
        }
    }

    /// Forgets all vehicles of a world that is gone.
    pub(super) fn clear(&mut self) {
        self.controllers.clear();
    }

    /// Sets the inputs of the wheels; other ones than before wake the chassis.
    pub(super) fn set_inputs(
        &mut self,
        world: &mut PhysicsWorld,
        id: BodyId,
        inputs: &[WheelInput],
    ) {
        let Some(controller) = self.controllers.get_mut(&id) else {
            return;
        };
        let dt = world.integration_parameters.dt;
        let mut differs = false;
        for (wheel, input) in controller.wheels_mut().iter_mut().zip(inputs) {
            // Rapier's brake is an impulse for each step.
            let (steering, force, brake) = (input.steering, input.force, input.brake * dt);
            differs |=
                (wheel.steering, wheel.engine_force, wheel.brake) != (steering, force, brake);
            (wheel.steering, wheel.engine_force, wheel.brake) = (steering, force, brake);
        }
        if differs {
            wake(world, controller.chassis);
        }
    }

    /// True if the wheels of a vehicle drive it; `None` for a body that is no vehicle.
    pub(super) fn drives(&self, id: BodyId) -> Option<bool> {
        let controller = self.controllers.get(&id)?;
        let mut wheels = controller.wheels().iter();
        Some(wheels.any(|wheel| wheel.engine_force != 0.0))
    }

    /// Pushes the chassis of all vehicles by their wheels for one step.
    pub(super) fn advance(&mut self, world: &mut PhysicsWorld) {
        for controller in self.controllers.values_mut() {
            let Some(chassis) = world.bodies.get(controller.chassis) else {
                continue;
            };
            if !chassis.is_enabled() || !chassis.is_dynamic() {
                continue;
            }
            let filter = filter(world, controller.chassis, chassis);
            if chassis.is_sleeping() {
                if !has_other_ground(world, controller, chassis, filter) {
                    continue;
                }
                wake(world, controller.chassis);
            }
            push(world, controller, filter);
        }
    }
}

/// Everything that the wheels of a chassis roll on: what the chassis itself touches.
fn filter<'a>(
    world: &PhysicsWorld,
    handle: RigidBodyHandle,
    chassis: &RigidBody,
) -> QueryFilter<'a> {
    let collider = chassis.colliders().first();
    let collider = collider.and_then(|handle| world.colliders.get(*handle));
    let groups = collider.map_or(InteractionGroups::all(), |collider| {
        collider.collision_groups()
    });
    QueryFilter::default()
        .exclude_rigid_body(handle)
        .exclude_sensors()
        .groups(groups)
}

/// Pushes a chassis by its wheels, but at most to the greatest speeds of bodies: absurd wheels would make Rapier give it up.
fn push(
    world: &mut PhysicsWorld,
    controller: &mut DynamicRayCastVehicleController,
    filter: QueryFilter<'_>,
) {
    let dt = world.integration_parameters.dt;
    let before = velocities(world, controller.chassis);
    let mounts = mend_rays(world, controller, filter);
    let queries = world.broad_phase.as_query_pipeline_mut(
        world.narrow_phase.query_dispatcher(),
        &mut world.bodies,
        &mut world.colliders,
        filter,
    );
    controller.update_vehicle(dt, queries);
    for (wheel, mount) in controller.wheels_mut().iter_mut().zip(mounts) {
        wheel.chassis_connection_point_cs = mount;
    }
    let (linear, angular) = velocities(world, controller.chassis);
    let (linear, angular) = if linear.is_finite() && angular.is_finite() {
        (
            linear * share_within(linear, SPEED_MAX),
            angular * share_within(angular, SPIN_MAX),
        )
    } else {
        before
    };
    let chassis = &mut world.bodies[controller.chassis];
    chassis.set_linvel(linear, false);
    chassis.set_angvel(angular, false);
}

/// Sideways shift of a wheel's ray that would pass between two triangles, metres.
const RAY_SHIFT: f32 = 1e-4;

/// Distance by which Rapier may find the ground too far away, as a share of the ray.
const SHARE_SLACK: f32 = 1e-2;

/// Shifts the rays of wheels that Rapier would let pass between two triangles of the ground; returns where the wheels are
/// mounted.
fn mend_rays(
    world: &PhysicsWorld,
    controller: &mut DynamicRayCastVehicleController,
    filter: QueryFilter<'_>,
) -> Vec<Vec3> {
    let queries = world.query_pipeline_with_filter(filter);
    let pose = *world.bodies[controller.chassis].position();
    let mut mounts = Vec::new();
    for wheel in controller.wheels_mut() {
        let mount = wheel.chassis_connection_point_cs;
        mounts.push(mount);
        let (across, along) = wheel.direction_cs.any_orthonormal_pair();
        let shifts = [
            across + along,
            across - along,
            -across - along,
            along - across,
        ];
        let found = nearest_hit(&queries, &ray(wheel, mount, &pose), 1.0);
        let Some((_, found)) = found else { continue };
        let hits = |shift: &Vec3| {
            let shifted = ray(wheel, mount + *shift * RAY_SHIFT, &pose);
            let hit = queries.cast_ray(&shifted, 1.0, true);
            hit.is_some_and(|(_, share)| share <= found.time_of_impact + SHARE_SLACK)
        };
        let shift = [Vec3::ZERO].into_iter().chain(shifts).find(hits);
        wheel.chassis_connection_point_cs += shift.unwrap_or_default() * RAY_SHIFT;
    }
    mounts
}

/// The ray of a wheel that is mounted there, as Rapier casts it: to the farthest ground.
fn ray(wheel: &RapierWheel, mount: Vec3, chassis: &RapierPose) -> Ray {
    let reach = wheel.suspension_rest_length + wheel.radius;
    let from = chassis.transform_point(mount);
    Ray::new(from, chassis.rotation * wheel.direction_cs * reach)
}

fn velocities(world: &PhysicsWorld, body: RigidBodyHandle) -> (Vec3, Vec3) {
    let body = &world.bodies[body];
    (body.linvel(), body.angvel())
}

fn wake(world: &mut PhysicsWorld, body: RigidBodyHandle) {
    if let Some(body) = world.bodies.get_mut(body) {
        body.wake_up(true);
    }
}

/// True if a wheel of a chassis that sleeps has other ground than in its last step, or ground that moves.
fn has_other_ground(
    world: &PhysicsWorld,
    controller: &DynamicRayCastVehicleController,
    chassis: &RigidBody,
    filter: QueryFilter<'_>,
) -> bool {
    let queries = world.query_pipeline_with_filter(filter);
    let mut is_carried = false;
    let is_other_somewhere = controller.wheels().iter().any(|wheel| {
        let reach = wheel.suspension_rest_length + wheel.radius;
        let mount = wheel.chassis_connection_point_cs;
        let ray = ray(wheel, mount, chassis.position());
        let found = nearest_hit(&queries, &ray, 1.0);
        let found = found.and_then(|(part, hit)| {
            let (solid, ground) = world.colliders.get_unknown_gen(part)?;
            let owner = solid.parent().and_then(|body| world.bodies.get(body));
            is_carried |= owner.is_some_and(|body| {
                let speed = body.velocity_at_point(ray.point_at(hit.time_of_impact));
                speed.length() > GROUND_SPEED
            });
            Some((ground, suspension(wheel, hit.time_of_impact * reach)))
        });
        let before = wheel.raycast_info();
        is_other(
            found,
            before
                .ground_object
                .map(|ground| (ground, before.suspension_length)),
        )
    });
    is_other_somewhere || is_carried
}

/// Length of a suspension with the ground at this distance, metres.
fn suspension(wheel: &RapierWheel, distance: f32) -> f32 {
    let (rest, travel) = (wheel.suspension_rest_length, wheel.max_suspension_travel);
    (distance - wheel.radius).clamp(rest - travel, rest + travel)
}

fn is_other(now: Option<(ColliderHandle, f32)>, before: Option<(ColliderHandle, f32)>) -> bool {
    match (now, before) {
        (Some((ground, length)), Some((ground_before, length_before))) => {
            ground != ground_before || (length - length_before).abs() > GROUND_CHANGE
        }
        (None, None) => false,
        _ => true,
    }
}

fn controller(chassis: RigidBodyHandle, vehicle: &Vehicle) -> DynamicRayCastVehicleController {
    let mut controller = DynamicRayCastVehicleController::new(chassis);
    for wheel in &vehicle.wheels {
        let tuning = WheelTuning {
            suspension_stiffness: wheel.stiffness,
            suspension_compression: wheel.compression,
            suspension_damping: wheel.relaxation,
            max_suspension_travel: wheel.travel,
            side_friction_stiffness: wheel.side_friction,
            friction_slip: wheel.friction_slip,
            max_suspension_force: wheel.force_max,
        };
        controller.add_wheel(
            wheel.position,
            wheel.direction.normalize(),
            wheel.axle.normalize(),
            wheel.rest_length,
            wheel.radius,
            &tuning,
        );
    }
    // The axis along which side forces act at the height of the centre of mass, so that the chassis leans less.
    let upright = vehicle
        .wheels
        .first()
        .map_or(Vec3::Y, |wheel| wheel.direction.abs());
    controller.index_up_axis = if upright.x > upright.y.max(upright.z) {
        0
    } else if upright.y >= upright.z {
        1
    } else {
        2
    };
    controller
}

impl RapierVehicles {
    /// The image for a snapshot; `None` if a vehicle cannot be encoded.
    pub(super) fn encode(&self, to: &mut Writer) -> Option<()> {
        to.varint(self.controllers.len() as u64);
        for (id, controller) in &self.controllers {
            id.encode(to);
            to.sized(&postcard::to_allocvec(controller).ok()?);
        }
        Some(())
    }

    pub(super) fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut vehicles = Self::default();
        for _ in 0..from.varint()? {
            let id = BodyId::decode(from)?;
            let bytes = from.sized(from.rest().len())?;
            let controller = postcard::from_bytes(bytes).map_err(|_| Malformed::Truncated)?;
            vehicles.controllers.insert(id, controller);
        }
        Ok(vehicles)
    }
}
