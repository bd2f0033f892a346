//! Characters of a Rapier world, by id.
//!
//! Computes how far each of them moves in a step, by the poses of the step before; `rapier` moves the bodies. Rapier
//! keeps nothing of a character: its fall and its contact with the ground are kept here.

use std::collections::BTreeMap;

use glam::Vec3;
use rapier3d::control::{
    CharacterAutostep, CharacterCollision, CharacterLength, KinematicCharacterController,
};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::bounding_volume::BoundingVolume;
use rapier3d::parry::query::ShapeCastOptions;
use rapier3d::prelude::{
    ColliderHandle, PhysicsWorld, QueryFilter, QueryPipeline, RigidBody, RigidBodyHandle,
    RigidBodySet, SharedShape,
};
use rhumb_protocol::scene::{BodyEvent, Character, JumpFrom};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;
use rhumb_solids::Grounds;

use crate::engine::interface::SPEED_MAX;

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
