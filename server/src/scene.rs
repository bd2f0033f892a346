//! One scene: what is in it, the engine that moves it, and its tick.
//!
//! Knows no members: who may command which body is decided before. Invariants: a refused command changes nothing; the
//! registry and the engine hold the same bodies; a scene whose engine failed takes no commands and steps no more.

use core::fmt;
use std::collections::BTreeMap;
use std::mem;

use glam::{DVec3, Vec3};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, IdRange, Invalid, JointId, Joints, SceneConfig,
    Shape, ShapeId,
};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Inertia, Metres, Tick, Twist};

use crate::digest::Digest;
use crate::engine::{Contact, Engine, EngineFault, NewBody, Push, RapierEngine, Workers};
use crate::hook::{Hook, HookError};
use crate::registry::Registry;

/// Bodies under one gravity, stepped together.
pub struct Scene {
    config: SceneConfig,
    gravity: Vec3,
    tick: Tick,
    registry: Registry,
    engine: Box<dyn Engine>,
    observations: Vec<Observation>,
    lost: Vec<(BodyId, RemovalCause)>,
    /// Bodies that were put elsewhere since the last step, as they were before: that is where they were at its tick.
    displaced: BTreeMap<BodyId, Observation>,
    hook: Option<Hook>,
    /// What the hook wishes before a step.
    wishes: Vec<Command>,
    digest: Digest,
}

/// What a step did apart from moving bodies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stepped {
    /// The tick that was reached.
    pub tick: Tick,
    /// Bodies that are gone, though nobody asked for it, in the order of ids.
    pub removed: Vec<(BodyId, RemovalCause)>,
    /// Why commands of the scene's hook were not done.
    pub refused: Vec<HookError>,
}

impl Scene {
    /// An empty scene that Rapier steps.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first of the config that is wrong.
    pub fn new(config: SceneConfig) -> Result<Self, Invalid> {
        Self::on(config, &Workers::default())
    }

    /// An empty scene that Rapier steps on these threads.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first of the config that is wrong.
    pub fn on(config: SceneConfig, workers: &Workers) -> Result<Self, Invalid> {
        config.check()?;
        Self::with_engine(config, Box::new(RapierEngine::on(&config, workers)))
    }

    /// An empty scene that another engine steps; the engine is empty too and under the config' gravity.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first of the config that is wrong.
    pub fn with_engine(config: SceneConfig, engine: Box<dyn Engine>) -> Result<Self, Invalid> {
        config.check()?;
        Ok(Self {
            config,
            gravity: config.gravity,
            tick: Tick::ZERO,
            registry: Registry::default(),
            engine,
            observations: Vec::new(),
            lost: Vec::new(),
            displaced: BTreeMap::new(),
            hook: None,
            wishes: Vec::new(),
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
            Command::AddShape { id, ref shape } => self.add_shape(id, shape)?,
            Command::RemoveShape { id } => {
                self.registry.remove_shape(id)?;
                self.engine.remove_shape(id);
            }
            Command::AddBody { desc, motion } => self.add_body(desc, motion)?,
            Command::RemoveBody { id } => {
                let joints = self.registry.remove_body(id)?;
                self.let_go(joints);
                self.engine.remove(id);
            }
            Command::SetPose {
                id,
                position,
                rotation,
            } => {
                self.known(id)?;
                if let Some(before) = self.engine.observe_one(id) {
                    self.displaced.entry(id).or_insert(before);
                }
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
            Command::AddJoint { id, joint } => {
                self.registry.add_joint(id, joint)?;
                self.engine.add_joint(id, &joint);
            }
            Command::RemoveJoint { id } => {
                self.registry.remove_joint(id)?;
                self.let_go([id]);
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
        let refused = self.ask_hook();
        self.engine.step(&mut self.lost)?;
        self.tick = self.tick.next();
        self.displaced.clear();
        for place in 0..self.lost.len() {
            let (id, _) = self.lost[place];
            // The engine names only bodies that it was given, each once.
            let known = self.registry.remove_body(id);
            debug_assert!(known.is_ok(), "{id} was lost and is not known");
            self.let_go(known.unwrap_or_default());
        }
        self.engine.observe(&mut self.observations);
        self.digest.fold_tick(self.tick, &self.observations);
        Ok(Stepped {
            tick: self.tick,
            removed: mem::take(&mut self.lost),
            refused,
        })
    }

    /// Gives the scene something that acts before each step from now on, in place of what it had.
    pub fn attach(&mut self, hook: Hook) {
        self.hook = Some(hook);
    }

    /// Does what the hook wishes, and says what of it was not done.
    fn ask_hook(&mut self) -> Vec<HookError> {
        let mut refused = Vec::new();
        let Some(mut hook) = self.hook.take() else {
            return refused;
        };
        if self.sound().is_ok() {
            let mut wishes = mem::take(&mut self.wishes);
            hook.act(self, &mut wishes);
            for command in wishes.drain(..) {
                refused.extend(self.steer(&command).err());
            }
            self.wishes = wishes;
        }
        self.hook = Some(hook);
        refused
    }

    fn steer(&mut self, command: &Command) -> Result<(), HookError> {
        match command {
            Command::SetPose { .. }
            | Command::SetVelocity { .. }
            | Command::Force { .. }
            | Command::Torque { .. }
            | Command::Impulse { .. }
            | Command::TorqueImpulse { .. } => self.apply(command).map_err(HookError::Refused),
            Command::AddShape { .. }
            | Command::RemoveShape { .. }
            | Command::AddBody { .. }
            | Command::RemoveBody { .. }
            | Command::SetGravity { .. }
            | Command::AddJoint { .. }
            | Command::RemoveJoint { .. } => Err(HookError::NotAMotion),
        }
    }

    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), CommandError> {
        self.registry.add_shape(id, shape.clone())?;
        if self.engine.add_shape(id, shape).is_err() {
            self.registry.remove_shape(id)?;
            return Err(CommandError::ShapeUnfit(id));
        }
        Ok(())
    }

    /// Tells the engine of joints that are gone.
    fn let_go(&mut self, joints: impl IntoIterator<Item = JointId>) {
        for id in joints {
            self.engine.remove_joint(id);
        }
    }

    fn add_body(&mut self, desc: BodyDesc, motion: BodyState) -> Result<(), CommandError> {
        let damping = desc.damping.unwrap_or(self.config.damping);
        self.registry.add_body(desc, damping)?;
        self.engine.add(&NewBody {
            id: desc.id,
            kind: desc.kind,
            shape: desc.shape,
            material: desc.material.unwrap_or(self.config.material),
            damping,
            gravity_scale: desc.gravity_scale,
            gyroscopic: desc.gyroscopic,
            turns: desc.turns,
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

    fn known(&self, id: BodyId) -> Result<&BodyDesc, CommandError> {
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

    /// Adds every body as it was after the last step, in the order of ids; static ones as asleep. One that was put
    /// elsewhere since is where it was then, and is observed again after the next step.
    pub fn observe_all(&self, out: &mut Vec<Observation>) {
        let ids = self.registry.bodies().map(|desc| desc.id);
        let before = |id: &BodyId| self.displaced.get(id).copied();
        out.extend(ids.filter_map(|id| before(&id).or_else(|| self.engine.observe_one(id))));
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
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// What pulls now, m/s².
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// What a body is.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        self.registry.body(id)
    }

    /// What every body is, in the order of ids.
    pub fn bodies(&self) -> impl Iterator<Item = &BodyDesc> {
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

    /// What holds bodies together.
    #[must_use]
    pub const fn joints(&self) -> &Joints {
        self.registry.joints()
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

    /// How a body resists being turned, if it tumbles when it is free: dynamic, gyroscopic, of unequal moments.
    #[must_use]
    pub fn inertia(&self, id: BodyId) -> Option<Inertia> {
        self.engine.inertia(id)
    }

    /// Adds, for each body that touches this one after the last step, where they do so deepest.
    pub fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        self.engine.contacts(id, out);
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
