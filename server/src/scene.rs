//! One scene: what is in it, the engine that moves it, and its tick.
//!
//! Knows no members: who may command which body is decided before. Invariants: a refused command changes nothing; the
//! registry and the engine hold the same bodies; a scene whose engine failed takes no commands and steps no more.

use core::fmt;
use std::mem;

use glam::{DVec3, Vec3};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Command, CommandError, IdRange, Invalid, SceneTerms, Shape, ShapeId,
};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Metres, Tick, Twist, Verbatim};

use crate::digest::Digest;
use crate::engine::{Engine, EngineFault, Newcomer, Push, RapierEngine};
use crate::registry::Registry;

/// Bodies under one gravity, stepped together.
pub struct Scene {
    terms: SceneTerms,
    gravity: Vec3,
    tick: Tick,
    registry: Registry,
    engine: Box<dyn Engine>,
    observations: Vec<Observation>,
    lost: Vec<(BodyId, RemovalCause)>,
    digest: Digest,
}

/// What a step did apart from moving bodies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stepped {
    /// The tick that was reached.
    pub tick: Tick,
    /// Bodies that are gone, though nobody asked for it, in the order of ids.
    pub removed: Vec<(BodyId, RemovalCause)>,
}

impl Scene {
    /// An empty scene that Rapier steps.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first of the terms that is wrong.
    pub fn new(terms: SceneTerms) -> Result<Self, Invalid> {
        terms.check()?;
        Self::with_engine(terms, Box::new(RapierEngine::new(&terms)))
    }

    /// An empty scene that another engine steps; the engine is empty too and under the terms' gravity.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first of the terms that is wrong.
    pub fn with_engine(terms: SceneTerms, engine: Box<dyn Engine>) -> Result<Self, Invalid> {
        terms.check()?;
        Ok(Self {
            terms,
            gravity: terms.gravity,
            tick: Tick::ZERO,
            registry: Registry::default(),
            engine,
            observations: Vec::new(),
            lost: Vec::new(),
            digest: Digest::START,
        })
    }

    /// Does what a command wishes; it acts from the next step on.
    ///
    /// A shape whose number is beyond the limit is unknown, a body whose index is so is not granted.
    ///
    /// # Errors
    ///
    /// [`CommandError`] says why nothing was done.
    pub fn apply(&mut self, command: &Command) -> Result<(), CommandError> {
        self.sound()?;
        command.check().map_err(CommandError::Invalid)?;
        match *command {
            Command::AddShape { id, shape } => self.registry.add_shape(id, shape)?,
            Command::RemoveShape { id } => self.registry.remove_shape(id)?,
            Command::AddBody { terms, motion } => self.add_body(terms, motion)?,
            Command::RemoveBody { id } => {
                self.registry.remove_body(id)?;
                self.engine.remove(id);
            }
            Command::SetPose {
                id,
                position,
                rotation,
            } => {
                self.known(id)?;
                self.engine.set_pose(id, position, rotation);
            }
            Command::SetVelocity {
                id,
                linear,
                angular,
            } => self.set_velocity(id, linear, angular)?,
            Command::Force { id, force } => self.push(id, Push::Force(force))?,
            Command::Torque { id, torque } => self.push(id, Push::Torque(torque))?,
            Command::Impulse { id, impulse } => self.push(id, Push::Impulse(impulse))?,
            Command::TorqueImpulse { id, impulse } => {
                self.push(id, Push::TorqueImpulse(impulse))?;
            }
            Command::SetGravity { gravity } => {
                self.gravity = gravity;
                self.engine.set_gravity(gravity);
            }
        }
        self.sound()
    }

    /// Steps once.
    ///
    /// # Errors
    ///
    /// [`SceneFault`] when the engine failed, now or before; the tick stays.
    pub fn step(&mut self) -> Result<Stepped, SceneFault> {
        self.observations.clear();
        self.engine.step(&mut self.lost)?;
        self.tick = self.tick.next();
        for (id, _) in &self.lost {
            // The engine names only bodies that it was given, each once.
            let known = self.registry.remove_body(*id);
            debug_assert!(known.is_ok(), "{id} was lost and is not known");
        }
        self.engine.observe(&mut self.observations);
        self.digest.fold_tick(self.tick, &self.observations);
        Ok(Stepped {
            tick: self.tick,
            removed: mem::take(&mut self.lost),
        })
    }

    fn add_body(&mut self, terms: BodyTerms, motion: Verbatim) -> Result<(), CommandError> {
        let damping = terms.damping.unwrap_or(self.terms.damping);
        let shape = self.registry.add_body(terms, damping)?;
        self.engine.add(&Newcomer {
            id: terms.id,
            kind: terms.kind,
            shape,
            material: terms.material.unwrap_or(self.terms.material),
            damping,
            gravity_scale: terms.gravity_scale,
            motion,
        });
        Ok(())
    }

    fn set_velocity(
        &mut self,
        id: BodyId,
        linear: Vec3,
        angular: Vec3,
    ) -> Result<(), CommandError> {
        if self.known(id)?.kind == BodyKind::Static {
            return Err(CommandError::NotPushable(id));
        }
        let wide = |v: Vec3| -> DVec3 { v.as_dvec3() };
        let twist = Twist {
            linear: wide(linear),
            angular: wide(angular),
        };
        self.engine.set_velocity(id, twist);
        Ok(())
    }

    fn push(&mut self, id: BodyId, push: Push) -> Result<(), CommandError> {
        if self.known(id)?.kind != BodyKind::Dynamic {
            return Err(CommandError::NotPushable(id));
        }
        self.engine.push(id, push);
        Ok(())
    }

    fn known(&self, id: BodyId) -> Result<&BodyTerms, CommandError> {
        self.body(id).ok_or(CommandError::UnknownBody(id))
    }

    fn sound(&self) -> Result<(), CommandError> {
        match self.engine.fault() {
            None => Ok(()),
            Some(_) => Err(CommandError::SceneFaulted),
        }
    }

    /// Adds what the last step changed: bodies that are awake, and once each that fell asleep or was static and put
    /// elsewhere, in the order of ids.
    pub fn observe(&self, out: &mut Vec<Observation>) {
        out.extend_from_slice(&self.observations);
    }

    /// Adds every body as it is now, in the order of ids; static ones as asleep.
    pub fn observe_all(&self, out: &mut Vec<Observation>) {
        let ids = self.registry.bodies().map(|terms| terms.id);
        out.extend(ids.filter_map(|id| self.engine.observe_one(id)));
    }

    /// What [`Self::observe`] adds.
    #[must_use]
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// One body as it is now.
    #[must_use]
    pub fn observation(&self, id: BodyId) -> Option<Observation> {
        self.body(id)?;
        self.engine.observe_one(id)
    }

    /// How many steps it has taken.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// What it was created with.
    #[must_use]
    pub const fn terms(&self) -> &SceneTerms {
        &self.terms
    }

    /// What pulls now, m/s².
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// What a body is.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<&BodyTerms> {
        self.registry.body(id)
    }

    /// What every body is, in the order of ids.
    pub fn bodies(&self) -> impl Iterator<Item = &BodyTerms> {
        self.registry.bodies()
    }

    /// How many bodies there are.
    #[must_use]
    pub const fn body_count(&self) -> usize {
        self.registry.body_count()
    }

    /// How many bodies the last step left awake.
    #[must_use]
    pub fn awake_count(&self) -> usize {
        self.engine.awake_count()
    }

    /// What a shape is.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.registry.shape(id)
    }

    /// Every shape, in the order of numbers.
    pub fn shapes(&self) -> impl Iterator<Item = (ShapeId, &Shape)> {
        self.registry.shapes()
    }

    /// The shape of a body.
    #[must_use]
    pub fn shape_of(&self, id: BodyId) -> Option<&Shape> {
        self.shape(self.body(id)?.shape)
    }

    /// Of the least ball around a body's centre of mass that holds it.
    #[must_use]
    pub fn bounding_radius(&self, id: BodyId) -> Option<Metres> {
        self.shape_of(id).map(Shape::bounding_radius)
    }

    /// The least generation that no body of these indices has had.
    ///
    /// `None` while a body lives among them, or when one of them is used up.
    #[must_use]
    pub fn vacancy(&self, range: &IdRange) -> Option<u16> {
        self.registry.vacancy(range)
    }

    /// Of everything that was ever observed.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }
}

/// Why a scene steps no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SceneFault {
    /// Its engine failed.
    Engine(EngineFault),
}

impl fmt::Display for SceneFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Engine(fault) => write!(f, "the scene stands still: {fault}"),
        }
    }
}

impl core::error::Error for SceneFault {}

impl From<EngineFault> for SceneFault {
    fn from(fault: EngineFault) -> Self {
        Self::Engine(fault)
    }
}
