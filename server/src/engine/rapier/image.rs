//! The image of a Rapier world: its bytes for a snapshot, and the world again.
//!
//! A world from an image steps on to the same bits. Shapes are not in the image, as the scene has them; colliders bring
//! theirs. Invariant: an image is read only after its authentication, since Rapier trusts it.

use std::panic::{AssertUnwindSafe, catch_unwind};

use rapier3d::prelude::{Collider, PhysicsWorld, RigidBody, RigidBodyHandle};
use rhumb_protocol::scene::{SceneConfig, Shape, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;

use super::joints::RapierJoints;
use super::locomotion::RapierCharacters;
use super::locomotion::RapierVehicles;
use super::rest_and_spin::RapierRest;
use super::rest_and_spin::RapierSpin;
use super::threads::StepThreads;
use super::{BodySlot, RapierEngine, solids};
use crate::engine::interface::FrozenEngine;
use crate::engine::kinematic_target::KinematicTarget;

impl RapierEngine {
    /// A copy of the world; `None` unless a step was the last change.
    pub(super) fn image(&self) -> Option<FrozenEngine> {
        if self.has_changed || self.fault.is_some() {
            return None;
        }
        let slots = self.encode_slots()?;
        let world = copy(&self.world);
        Some(Box::new(move || {
            let mut to = Writer::new();
            to.sized(&slots);
            to.raw(&postcard::to_allocvec(&world).ok()?);
            Some(to.into_bytes())
        }))
    }

    /// A copy that steps on to the same bits; `None` unless a step was the last change.
    pub(super) fn duplicate(&self) -> Option<Self> {
        if self.has_changed || self.fault.is_some() {
            return None;
        }
        let mut world = copy(&self.world);
        self.threads.install(&mut world);
        Some(Self {
            world,
            threads: self.threads.clone(),
            integrator: self.integrator,
            fault: None,
            solids: self.solids.clone(),
            joints: self.joints.clone(),
            characters: self.characters.clone(),
            vehicles: self.vehicles.clone(),
            rest: self.rest.clone(),
            spin: RapierSpin::default(),
            crowding: self.crowding.clone(),
            places: self.places.clone(),
            kinematic_targets: self.kinematic_targets.clone(),
            forced: Vec::new(),
            displaced: Vec::new(),
            stirred: Vec::new(),
            awake: self.awake.clone(),
            awake_before: self.awake_before.clone(),
            observed: self.observed.clone(),
            swept: self.swept.clone(),
            sensors: self.sensors.clone(),
            half_spaces: self.half_spaces.clone(),
            sensor_starts: Vec::new(),
            crossed: self.crossed.clone(),
            has_changed: false,
        })
    }

    /// A world from its image. `shapes`: the scene's.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for bytes that are no image of this version.
    pub(crate) fn from_image<'a>(
        config: &SceneConfig,
        threads: &StepThreads,
        shapes: impl Iterator<Item = (ShapeId, &'a Shape)>,
        image: &[u8],
    ) -> Result<Self, Malformed> {
        let mut engine = Self::on(config, threads);
        for (id, shape) in shapes {
            let solid = solids::solid(shape).map_err(|_| Malformed::OutOfRange)?;
            engine.solids.insert(id, solid);
        }
        let mut from = Reader::new(image);
        engine.decode_slots(from.sized(image.len())?)?;
        let decode = || postcard::from_bytes::<PhysicsWorld>(from.rest());
        let world = catch_unwind(AssertUnwindSafe(decode));
        engine.world = world
            .map_err(|_| Malformed::OutOfRange)?
            .map_err(|_| Malformed::Truncated)?;
        threads.install(&mut engine.world);
        let swept = engine.world.bodies.iter();
        let swept = swept.filter(|(_, body)| body.is_ccd_enabled() && body.is_enabled());
        engine.swept = swept.map(|(_, body)| super::translate::id(body)).collect();
        let is_sensor = |body: &RigidBody| {
            let first = body.colliders().first();
            first
                .and_then(|solid| engine.world.colliders.get(*solid))
                .is_some_and(Collider::is_sensor)
        };
        let sensors = engine.world.bodies.iter();
        let sensors = sensors.filter(|(_, body)| body.is_enabled() && is_sensor(body));
        let sensors = sensors
            .map(|(_, body)| super::translate::id(body))
            .collect();
        engine.sensors = sensors;
        let planes = engine.world.colliders.iter();
        let planes = planes.filter(|(_, solid)| solid.shape().as_halfspace().is_some());
        let bodies = planes.filter_map(|(_, solid)| engine.world.bodies.get(solid.parent()?));
        engine.half_spaces = bodies.map(super::translate::id).collect();
        Ok(engine)
    }

    /// Everything beside the world and the scene's shapes; `None` if a vehicle cannot be encoded.
    fn encode_slots(&self) -> Option<Vec<u8>> {
        let mut to = Writer::new();
        let places = self.places.iter().flatten();
        to.varint(places.clone().count() as u64);
        for place in places {
            place.id.encode(&mut to);
            let (index, generation) = place.handle.into_raw_parts();
            to.varint(u64::from(index));
            to.varint(u64::from(generation));
        }
        self.joints.encode(&mut to);
        self.characters.encode(&mut to);
        self.vehicles.encode(&mut to)?;
        self.rest.encode(&mut to);
        to.varint(self.kinematic_targets.len() as u64);
        for (id, target) in &self.kinematic_targets {
            id.encode(&mut to);
            target.encode(&mut to);
        }
        to.varint(self.awake.len() as u64);
        for place in &self.awake {
            place.id.encode(&mut to);
        }
        Some(to.into_bytes())
    }

    fn decode_slots(&mut self, bytes: &[u8]) -> Result<(), Malformed> {
        let mut from = Reader::new(bytes);
        for _ in 0..from.varint()? {
            let id = BodyId::decode(&mut from)?;
            let (index, generation) = (from.varint32()?, from.varint32()?);
            let handle = RigidBodyHandle::from_raw_parts(index, generation);
            let index = id.index() as usize;
            if index >= self.places.len() {
                self.places.resize(index + 1, None);
            }
            self.places[index] = Some(BodySlot { id, handle });
        }
        self.joints = RapierJoints::decode(&mut from)?;
        self.characters = RapierCharacters::decode(&mut from)?;
        self.vehicles = RapierVehicles::decode(&mut from)?;
        self.rest = RapierRest::decode(&mut from)?;
        for _ in 0..from.varint()? {
            let id = BodyId::decode(&mut from)?;
            let target = KinematicTarget::decode(&mut from)?;
            self.kinematic_targets.insert(id, target);
        }
        for _ in 0..from.varint()? {
            let id = BodyId::decode(&mut from)?;
            self.awake
                .push(self.place(id).ok_or(Malformed::OutOfRange)?);
        }
        from.finish()
    }
}

/// A copy of everything that an image has.
fn copy(world: &PhysicsWorld) -> PhysicsWorld {
    PhysicsWorld {
        gravity: world.gravity,
        integration_parameters: world.integration_parameters,
        islands: world.islands.clone(),
        broad_phase: world.broad_phase.clone(),
        narrow_phase: world.narrow_phase.clone(),
        bodies: world.bodies.clone(),
        colliders: world.colliders.clone(),
        impulse_joints: world.impulse_joints.clone(),
        multibody_joints: world.multibody_joints.clone(),
        soft_bodies: world.soft_bodies.clone(),
        ..PhysicsWorld::new()
    }
}
