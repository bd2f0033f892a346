//! Characters and vehicles of a Rapier world, by id.
//!
//! Computes how far each of them moves in a step, by the poses of the step before; `rapier` moves the bodies. Rapier
//! keeps nothing of a character: its fall and its contact with the ground are kept here.
//!
//! Each step pushes every awake chassis by its wheels, before the engine steps. A chassis that sleeps is left alone
//! until the ground below a wheel changes.

use std::collections::BTreeMap;

use glam::Vec3;
use rapier3d::control::{
    CharacterAutostep, CharacterCollision, CharacterLength, DynamicRayCastVehicleController,
    KinematicCharacterController, Wheel as RapierWheel, WheelTuning,
};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query::ShapeCastOptions;
use rapier3d::prelude::{
    ColliderHandle, InteractionGroups, PhysicsWorld, QueryFilter, QueryPipeline, Ray, RigidBody,
    RigidBodyHandle, RigidBodySet, SharedShape,
};
use rhumb_protocol::scene::{BodyEvent, Character, JumpFrom, Vehicle, WheelInput};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;
use rhumb_solids::{Grounds, nearest_hit};

use super::body::share_within;
use crate::engine::interface::{SPEED_MAX, SPIN_MAX};

/// The characters.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierCharacters {
    states: BTreeMap<BodyId, CharacterState>,
    /// The characters that reached the ground in the last step, in the order of ids.
    landed: Vec<BodyId>,
    /// The characters that left it.
    lifted: Vec<BodyId>,
}

#[derive(Clone, Copy, Debug)]
struct CharacterState {
    character: Character,
    /// Speed along its direction up beside the velocity that it keeps, m/s: negative in a fall.
    rise: f32,
    is_grounded: bool,
}

/// Distance below a character, beyond its offset, within which ground carries it, metres.
const GROUND_REACH: f32 = 0.05;
/// Movements of a step below this length are rounding errors of a character that stands, metres.
const MOVEMENT_MIN: f32 = 1e-5;
/// A gap that is too small by less than this is not restored, metres.
const GAP_SLACK: f32 = 1e-5;
/// The gap is restored by at most this in a step, metres.
const KEEP_OFF_MAX: f32 = 0.25;
/// A fall or a rise ends when less than this share of its way was free.
const FREE_SHARE: f32 = 0.25;
/// Factor of the normals that keeps a sliding character out of what it touches: Rapier's own.
const NORMAL_NUDGE: f32 = 1e-4;

impl RapierCharacters {
    /// Makes a body a character, or replaces its settings.
    pub(super) fn set(&mut self, id: BodyId, character: Character) {
        let state = self.states.entry(id).or_insert(CharacterState {
            character,
            rise: 0.0,
            is_grounded: false,
        });
        state.character = character;
    }

    /// Removes a character, if it is one.
    pub(super) fn remove(&mut self, id: BodyId) {
        self.states.remove(&id);
        self.landed.retain(|other| *other != id);
        self.lifted.retain(|other| *other != id);
    }

    /// Forgets all characters of a world that is gone.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Sets the speed with which a character rises, m/s.
    pub(super) fn jump(&mut self, id: BodyId, speed: f32, from: JumpFrom) {
        if let Some(state) = self.states.get_mut(&id)
            && (state.is_grounded || from == JumpFrom::Anywhere)
        {
            state.rise = speed;
        }
    }

    pub(super) fn contains(&self, id: BodyId) -> bool {
        self.states.contains_key(&id)
    }

    pub(super) fn ids(&self) -> Vec<BodyId> {
        self.states.keys().copied().collect()
    }

    /// Begins a step: the events of the one before are over.
    pub(super) fn begin_step(&mut self) {
        self.landed.clear();
        self.lifted.clear();
    }

    /// Adds the events of the last step, in the order of codes, then of ids.
    pub(super) fn events(&self, out: &mut Vec<BodyEvent>) {
        out.extend(self.landed.iter().copied().map(BodyEvent::ReachedGround));
        out.extend(self.lifted.iter().copied().map(BodyEvent::LeftGround));
    }

    /// Ends the fall of a character that was put elsewhere; whether ground carries it there, the next step finds.
    pub(super) fn halt(&mut self, id: BodyId) {
        if let Some(state) = self.states.get_mut(&id) {
            state.rise = 0.0;
            if std::mem::take(&mut state.is_grounded) {
                self.lifted.push(id);
            }
        }
    }

    /// The movement of a character in the next step, metres; pushes the dynamic bodies that it walks into.
    ///
    /// `velocity`: that it keeps, m/s.
    pub(super) fn advance(
        &mut self,
        world: &mut PhysicsWorld,
        (id, body): (BodyId, RigidBodyHandle),
        velocity: Vec3,
    ) -> Vec3 {
        let Some(state) = self.states.get_mut(&id) else {
            return Vec3::ZERO;
        };
        let Some(mut walker) = Walker::of(world, body, &state.character) else {
            return Vec3::ZERO;
        };
        let dt = world.integration_parameters.dt;
        let up = walker.controller.up;
        let gravity = world.gravity * world.bodies[body].gravity_scale();
        let rise = state.rise + gravity.dot(up) * dt;
        state.rise = rise.clamp(-SPEED_MAX, SPEED_MAX);
        let asked = state.rise * dt;
        walker.keep_off(world, &state.character);
        let carried = match state.rise <= 0.0 {
            true => walker.carried(world, &state.character),
            false => Vec3::ZERO,
        };
        let (level, mut collisions) = ((velocity + carried) * dt, Vec::new());
        let moved = walker.moved(world, level + up * asked, &mut collisions);
        walker.push(world, state.character.mass, &collisions);
        let stands = state.rise <= 0.0 && walker.ground(world, moved, &state.character).is_some();
        let risen = (moved - level).dot(up);
        // A way that is too short to be gone is no obstacle: a fall begins with such ways where ticks are short.
        let is_blocked =
            asked.abs() >= MOVEMENT_MIN && risen * asked.signum() < FREE_SHARE * asked.abs();
        if stands || is_blocked {
            state.rise = 0.0;
        }
        if stands != state.is_grounded {
            state.is_grounded = stands;
            let changed = if stands {
                &mut self.landed
            } else {
                &mut self.lifted
            };
            changed.push(id);
        }
        let whole = walker.kept_off + moved;
        if whole.length() < MOVEMENT_MIN {
            return Vec3::ZERO;
        }
        whole
    }
}

/// A character in its world, for one step.
struct Walker<'a> {
    controller: KinematicCharacterController,
    shape: SharedShape,
    pose: RapierPose,
    /// Everything that it touches.
    filter: QueryFilter<'a>,
    /// The part of the movement that restored its gap, metres; `pose` is behind it.
    kept_off: Vec3,
}

impl Walker<'_> {
    fn of(world: &PhysicsWorld, body: RigidBodyHandle, character: &Character) -> Option<Self> {
        let collider = world
            .colliders
            .get(*world.bodies.get(body)?.colliders().first()?)?;
        let up = match character.up {
            Some(up) => up.normalize(),
            None => (-world.gravity).try_normalize().unwrap_or(Vec3::Y),
        };
        let controller = KinematicCharacterController {
            up,
            offset: CharacterLength::Absolute(character.offset),
            slide: true,
            autostep: character.step.map(|step| CharacterAutostep {
                max_height: CharacterLength::Absolute(step.height),
                min_width: CharacterLength::Absolute(step.width),
                include_dynamic_bodies: step.onto_dynamic,
            }),
            max_slope_climb_angle: character.climb_angle,
            min_slope_slide_angle: character.slide_angle,
            snap_to_ground: character.snap.map(CharacterLength::Absolute),
            normal_nudge_factor: NORMAL_NUDGE,
        };
        let mut pose = *world.bodies[body].position();
        if let Some(local) = collider.position_wrt_parent() {
            pose *= *local;
        }
        Some(Self {
            controller,
            shape: collider.shared_shape().clone(),
            pose,
            kept_off: Vec3::ZERO,
            filter: QueryFilter::default()
                .exclude_rigid_body(body)
                .exclude_sensors()
                .groups(collider.collision_groups()),
        })
    }

    /// Moves it away from what is nearer than its gap: Rapier's casts go through what begins within it.
    ///
    /// Dynamic bodies give way themselves, unless they carry it.
    fn keep_off(&mut self, world: &PhysicsWorld, character: &Character) {
        let (offset, steepest) = (character.offset, steepest(character));
        let queries = world.query_pipeline_with_filter(self.filter);
        let near = self.shape.compute_aabb(&self.pose).loosened(offset);
        for (_, collider) in queries.intersect_aabb_conservative(near) {
            let there = collider.position();
            // The other order is wrong for half-spaces.
            let contact = queries.dispatcher.contact(
                &there.inv_mul(&self.pose),
                collider.shape(),
                &*self.shape,
                offset,
            );
            let Ok(Some(contact)) = contact else { continue };
            let (out, gap) = (there.rotation * contact.normal1, offset - contact.dist);
            let owner = collider.parent().and_then(|body| world.bodies.get(body));
            let carries = self.controller.up.angle_between(out) <= steepest;
            if gap < GAP_SLACK || owner.is_some_and(RigidBody::is_dynamic) && !carries {
                continue;
            }
            let way = out * (gap + NORMAL_NUDGE);
            if way.is_finite() && (self.kept_off + way).length() <= KEEP_OFF_MAX {
                self.kept_off += way;
                self.pose.translation += way;
            }
        }
    }

    /// The movement that is possible of the one that it asks for, metres.
    fn moved(
        &self,
        world: &PhysicsWorld,
        asked: Vec3,
        collisions: &mut Vec<CharacterCollision>,
    ) -> Vec3 {
        // Without a way Rapier would correct overlaps, and take half-spaces for one.
        if asked.length() < MOVEMENT_MIN {
            return Vec3::ZERO;
        }
        let dispatcher = Grounds::dispatcher();
        let queries = world.query_pipeline_with_filter(self.filter);
        // Rapier's controller gets no bodies. It carries a character by a kinematic one so that each of its casts begins
        // at the gap from it, and ends there (rapier3d 0.36.1): `carried` does that here.
        let (controller, no_bodies) = (self.controller_near(&queries, asked), RigidBodySet::new());
        let movement = controller.move_shape(
            world.integration_parameters.dt,
            &QueryPipeline {
                dispatcher: &dispatcher,
                bodies: &no_bodies,
                ..queries
            },
            &*self.shape,
            &self.pose,
            asked,
            |collision| collisions.push(collision),
        );
        let moved = movement.translation;
        if moved.is_finite() { moved } else { Vec3::ZERO }
    }

    /// Pushes the dynamic bodies of these collisions. `mass`: of the character, kg.
    fn push(&self, world: &mut PhysicsWorld, mass: f32, collisions: &[CharacterCollision]) {
        if mass == 0.0 || collisions.is_empty() {
            return;
        }
        let dt = world.integration_parameters.dt;
        let mut queries = world.broad_phase.as_query_pipeline_mut(
            world.narrow_phase.query_dispatcher(),
            &mut world.bodies,
            &mut world.colliders,
            self.filter,
        );
        (self.controller).solve_character_collision_impulses(
            dt,
            &mut queries,
            &*self.shape,
            mass,
            collisions,
        );
    }

    /// The controller, without steps if it may step onto no dynamic body and one is near: it cannot tell them apart.
    fn controller_near(
        &self,
        queries: &QueryPipeline<'_>,
        asked: Vec3,
    ) -> KinematicCharacterController {
        let mut controller = self.controller;
        let excludes = controller
            .autostep
            .is_some_and(|step| !step.include_dynamic_bodies);
        if excludes {
            let reach = asked.length() + KEEP_OFF_MAX;
            let around = self.shape.compute_aabb(&self.pose).loosened(reach);
            let mut near = queries.intersect_aabb_conservative(around);
            let is_dynamic = near.any(|(_, collider)| {
                let owner = collider.parent().and_then(|body| queries.bodies.get(body));
                owner.is_some_and(RigidBody::is_dynamic)
            });
            if is_dynamic {
                controller.autostep = None;
            }
        }
        controller
    }

    /// Velocity of the kinematic ground that carries it, where its feet are, m/s; zero on other ground and on none.
    fn carried(&self, world: &PhysicsWorld, character: &Character) -> Vec3 {
        let ground = self.ground(world, Vec3::ZERO, character);
        let solid = ground.and_then(|solid| world.colliders.get(solid));
        let body = solid.and_then(|solid| world.bodies.get(solid.parent()?));
        let Some(body) = body.filter(|body| body.is_kinematic()) else {
            return Vec3::ZERO;
        };
        let up = self.controller.up;
        let half = self.shape.compute_aabb(&self.pose).half_extents();
        let feet = self.pose.translation - up * half.dot(up.abs());
        let velocity = body.velocity_at_point(feet);
        if velocity.is_finite() {
            velocity
        } else {
            Vec3::ZERO
        }
    }

    /// The ground that carries it after this movement: some that it can climb, or does not slide from.
    fn ground(
        &self,
        world: &PhysicsWorld,
        moved: Vec3,
        character: &Character,
    ) -> Option<ColliderHandle> {
        let up = self.controller.up;
        let there = RapierPose::from_parts(self.pose.translation + moved, self.pose.rotation);
        let options = ShapeCastOptions {
            target_distance: character.offset,
            stop_at_penetration: false,
            max_time_of_impact: GROUND_REACH,
            compute_impact_geometry_on_penetration: true,
        };
        let dispatcher = Grounds::dispatcher();
        let queries = QueryPipeline {
            dispatcher: &dispatcher,
            ..world.query_pipeline_with_filter(self.filter)
        };
        let (ground, hit) = queries.cast_shape(&there, -up, &*self.shape, options)?;
        (up.angle_between(hit.normal1) <= steepest(character)).then_some(ground)
    }
}

/// The steepest ground that carries a character, radians.
fn steepest(character: &Character) -> f32 {
    character.climb_angle.max(character.slide_angle)
}

impl Wire for RapierCharacters {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.states.len() as u64);
        for (id, state) in &self.states {
            id.encode(to);
            state.character.encode(to);
            to.f32(state.rise);
            to.u8(u8::from(state.is_grounded));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut characters = Self::default();
        for _ in 0..from.varint()? {
            let id = BodyId::decode(from)?;
            let state = CharacterState {
                character: Character::decode(from)?,
                rise: from.f32()?,
                is_grounded: from.u8()? != 0,
            };
            characters.states.insert(id, state);
        }
        Ok(characters)
    }
}

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
