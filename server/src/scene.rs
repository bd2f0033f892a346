//! One scene: its bodies, its engine, its tick, its digest.
//!
//! Members are not known here; their rights are checked before. Invariants: a refused command changes nothing;
//! registry and engine have the same bodies; a scene whose engine failed takes no commands and no steps.

mod image;
mod moving;

use core::fmt;
use std::collections::BTreeMap;
use std::mem;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::MOMENT_MAX;
use rhumb_protocol::message::{QueryError, RemovalCause};
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, Command, CommandError, Contact, Hit, Invalid, Joint,
    JointId, Joints, Locomotion, Quantity, Query, QueryCandidate, QueryKind, SceneConfig, Shape,
    ShapeId,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Inertia, Metres, Tick};

use crate::baking::BakedShapes;
use crate::engine::{
    BakedShape, Baker, BodyProperties, Engine, EngineFault, EnginePart, Push, RapierEngine,
    StepThreads, UnusableShape,
};
use crate::event_monitor::{EventMonitor, StepEvents};
use crate::record::{AppliedCommand, LogEntry, RunRecord};
use crate::registry::Registry;

pub use self::image::{FrozenScene, IMAGE_FORMAT};

/// Bodies under one gravity, stepped together.
pub struct Scene {
    config: SceneConfig,
    gravity: Vec3,
    tick: Tick,
    registry: Registry,
    engine: Box<dyn Engine>,
    observations: Vec<Observation>,
    lost: Vec<(BodyId, RemovalCause)>,
    /// Bodies that were displaced since the last step, as they were at its tick.
    displaced: BTreeMap<BodyId, Observation>,
    digest: Digest,
    event_monitor: EventMonitor,
    record: RunRecord,
    /// Solids that were made beside the steps, for commands that are to come.
    baked: BakedShapes,
    /// The most pairs that a step may meet for the first time; `None` has none counted.
    crowding_max: Option<u32>,
    /// True after a panic outside the engine.
    broken: bool,
}

/// Results of a step beside the motion of bodies.
#[derive(Clone, Debug, PartialEq)]
pub struct Stepped {
    /// The tick that was reached.
    pub tick: Tick,
    /// Bodies that the step removed, in the order of ids.
    pub removed: Vec<(BodyId, RemovalCause)>,
    /// The events of bodies that report them.
    pub happened: StepEvents,
    /// Joints that broke in the step, in the order of ids.
    pub broken: Vec<JointId>,
}

impl Scene {
    /// An empty scene that Rapier steps.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid part of the configuration.
    pub fn new(config: SceneConfig) -> Result<Self, Invalid> {
        Self::on(config, &StepThreads::default())
    }

    /// An empty scene that Rapier steps on these threads.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid part of the configuration.
    pub fn on(config: SceneConfig, threads: &StepThreads) -> Result<Self, Invalid> {
        config.check()?;
        Self::with_engine(config, Box::new(RapierEngine::on(&config, threads)))
    }

    /// An empty scene with another engine, which must be empty and have the configuration's gravity.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid part of the configuration.
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
            digest: Digest::START,
            event_monitor: EventMonitor::default(),
            record: RunRecord::default(),
            baked: BakedShapes::default(),
            crowding_max: None,
            broken: false,
        })
    }

    /// Applies a command; it acts from the next step on.
    ///
    /// A shape whose number is beyond the limit counts as unknown, a body whose index is so as not granted.
    ///
    /// # Errors
    ///
    /// [`CommandError`] names the reason; nothing has changed.
    pub fn apply(&mut self, command: &Command) -> Result<(), CommandError> {
        self.sound()?;
        let applied = catch_unwind(AssertUnwindSafe(|| self.apply_unguarded(command)));
        self.broken = applied.is_err();
        applied.map_err(|_| CommandError::SceneFaulted)??;
        self.sound()?;
        self.record.push(self.tick, || {
            let applied = AppliedCommand {
                command: command.clone(),
                client: None,
                author: None,
            };
            LogEntry::Applied(applied.into())
        });
        Ok(())
    }

    fn apply_unguarded(&mut self, command: &Command) -> Result<(), CommandError> {
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
                self.event_monitor.remove(id);
                self.forget_joints(joints);
                self.engine.remove(id);
            }
            Command::SetPose {
                id,
                position,
                rotation,
            } => self.set_pose(id, position, rotation)?,
            Command::SetVelocity {
                id,
                linear,
                angular,
            } => self.set_velocity(id, linear, angular)?,
            Command::Force { id, force } => self.push(id, Push::Force(force))?,
            Command::Torque { id, torque } => self.push(id, Push::Torque(torque))?,
            Command::Impulse { id, impulse } => self.push(id, Push::Impulse(impulse))?,
            Command::ForceAt { id, force, point } => self.push(id, Push::ForceAt(force, point))?,
            Command::ImpulseAt { id, impulse, point } => {
                self.push(id, Push::ImpulseAt(impulse, point))?;
            }
            Command::Sleep { id } => self.set_activity(id, Activity::Asleep)?,
            Command::Wake { id } => self.set_activity(id, Activity::Awake)?,
            Command::TorqueImpulse { id, impulse } => {
                self.push(id, Push::TorqueImpulse(impulse))?;
            }
            Command::SetGravity { gravity } => {
                self.gravity = gravity;
                self.engine.set_gravity(gravity);
            }
            Command::AddJoint { id, ref joint } => {
                self.supported(EnginePart::Joint(joint))?;
                self.registry.add_joint(id, **joint)?;
                self.act_joint(id, joint);
            }
            Command::ChangeJoint { id, ref joint } => {
                self.supported(EnginePart::Joint(joint))?;
                self.registry.change_joint(id, **joint)?;
                self.engine.remove_joint(id);
                self.act_joint(id, joint);
            }
            Command::ChangeBody { desc } => self.change_body(desc)?,
            Command::RemoveJoint { id } => {
                self.registry.remove_joint(id)?;
                self.forget_joints([id]);
            }
            Command::SetEvents { id, events } => {
                self.known(id)?;
                self.event_monitor.set(id, events, &*self.engine);
            }
            Command::SetLocomotion { id, ref locomotion } => self.set_locomotion(id, locomotion)?,
            Command::Jump { id, speed, from } => self.jump(id, speed, from)?,
            Command::SetWheels { id, ref inputs } => self.set_wheels(id, inputs)?,
        }
        Ok(())
    }

    /// Steps once.
    ///
    /// # Errors
    ///
    /// [`SceneFault`] when the engine failed, now or before; the tick stays.
    pub fn step(&mut self) -> Result<Stepped, SceneFault> {
        if self.broken {
            return Err(EngineFault::Panicked.into());
        }
        self.check_crowding()?;
        let before = self.tick;
        let stepped = catch_unwind(AssertUnwindSafe(|| self.step_unguarded()));
        self.broken = stepped.is_err();
        let stepped = stepped.map_err(|_| EngineFault::Panicked)??;
        let digest = self.digest.value();
        self.record.push(before, || LogEntry::Stepped(digest));
        Ok(stepped)
    }

    fn step_unguarded(&mut self) -> Result<Stepped, SceneFault> {
        self.observations.clear();
        self.engine.step(&mut self.lost)?;
        self.tick = self.tick.next();
        self.displaced.clear();
        for place in 0..self.lost.len() {
            let (id, _) = self.lost[place];
            // The engine names only bodies that it was given, each once.
            let known = self.registry.remove_body(id);
            self.event_monitor.remove(id);
            debug_assert!(known.is_ok(), "{id} is lost but unknown");
            self.forget_joints(known.unwrap_or_default());
        }
        let mut broken = Vec::new();
        self.engine.overloaded_joints(&mut broken);
        broken.retain(|id| self.registry.remove_joint(*id).is_ok());
        self.forget_joints(broken.iter().copied());
        self.engine.observe(&mut self.observations);
        self.digest.fold_tick(self.tick, &self.observations);
        let mut happened =
            self.event_monitor
                .observe(&*self.engine, &self.registry, &self.observations);
        let faults = self.lost.iter();
        for (id, _) in faults.filter(|(_, cause)| *cause == RemovalCause::NotFinite) {
            happened.push(BodyEvent::Fault(*id));
        }
        let mut grounds = Vec::new();
        self.engine.ground_events(&mut grounds);
        grounds.into_iter().for_each(|event| happened.push(event));
        Ok(Stepped {
            happened,
            tick: self.tick,
            removed: mem::take(&mut self.lost),
            broken,
        })
    }

    /// The record of its run.
    #[must_use]
    pub const fn record(&self) -> &RunRecord {
        &self.record
    }

    /// The record of its run.
    pub const fn record_mut(&mut self) -> &mut RunRecord {
        &mut self.record
    }

    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), CommandError> {
        self.supported(EnginePart::Shape(shape))?;
        let baked = self.baked.take(id, shape);
        self.registry.add_shape(id, shape.clone())?;
        let added = match baked {
            Some(solid) => solid.and_then(|solid| self.engine.add_baked(id, solid)),
            None => self.engine.add_shape(id, shape),
        };
        if added.is_err() {
            self.registry.remove_shape(id)?;
            return Err(CommandError::ShapeUnfit(id));
        }
        Ok(())
    }

    /// Tells the engine of removed joints.
    fn forget_joints(&mut self, joints: impl IntoIterator<Item = JointId>) {
        for id in joints {
            self.engine.remove_joint(id);
        }
    }

    fn add_body(&mut self, desc: BodyDesc, motion: BodyState) -> Result<(), CommandError> {
        let properties = self.properties(desc);
        self.supported(EnginePart::Body(&properties))?;
        self.check_moment(&properties)?;
        self.check_crowding_with(&properties, &motion)?;
        self.registry.add_body(desc, properties.damping)?;
        self.engine.add(&properties, motion);
        Ok(())
    }

    fn change_body(&mut self, desc: BodyDesc) -> Result<(), CommandError> {
        let properties = self.properties(desc);
        self.supported(EnginePart::Body(&properties))?;
        self.check_moment(&properties)?;
        let before = self.registry.change_body(desc, properties.damping)?;
        // Joints of disabled bodies are not in the engine, which fails on some of them.
        let joints = self.registry.joints().of_body(desc.id);
        let joints: Vec<_> = joints.map(|(id, joint)| (id, *joint)).collect();
        if before.enabled && !desc.enabled {
            self.forget_joints(joints.iter().map(|(id, _)| *id));
        }
        self.engine.change(&before, &properties);
        if self.registry.end_unfit_locomotion(desc.id) {
            self.engine.set_locomotion(desc.id, &Locomotion::None);
        }
        if !before.enabled && desc.enabled {
            for (id, joint) in joints {
                self.act_joint(id, &joint);
            }
        }
        Ok(())
    }

    /// Adds a joint to the engine if both of its bodies are enabled.
    fn act_joint(&mut self, id: JointId, joint: &Joint) {
        let is_enabled = |id: BodyId| self.body(id).is_some_and(|desc| desc.enabled);
        if joint.bodies.into_iter().all(is_enabled) {
            self.engine.add_joint(id, joint);
        }
    }

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) -> Result<(), CommandError> {
        self.known(id)?;
        if let Some(before) = self.engine.observe_one(id) {
            self.displaced.entry(id).or_insert(before);
        }
        self.engine.set_pose(id, position, rotation);
        Ok(())
    }

    fn set_activity(&mut self, id: BodyId, activity: Activity) -> Result<(), CommandError> {
        self.pushable(id)?;
        self.engine.set_activity(id, activity);
        Ok(())
    }

    fn pushable(&self, id: BodyId) -> Result<(), CommandError> {
        match self.enabled(id)?.kind {
            BodyKind::Dynamic => Ok(()),
            BodyKind::Fixed | BodyKind::Kinematic => Err(CommandError::NotPushable(id)),
        }
    }

    fn enabled(&self, id: BodyId) -> Result<&BodyDesc, CommandError> {
        let desc = self.known(id)?;
        if desc.enabled {
            Ok(desc)
        } else {
            Err(CommandError::BodyDisabled(id))
        }
    }

    fn known(&self, id: BodyId) -> Result<&BodyDesc, CommandError> {
        self.body(id).ok_or(CommandError::UnknownBody(id))
    }

    /// True if the engine has not failed.
    pub(crate) fn is_sound(&self) -> bool {
        !self.broken && self.engine.fault().is_none()
    }

    fn sound(&self) -> Result<(), CommandError> {
        if self.is_sound() {
            Ok(())
        } else {
            Err(CommandError::SceneFaulted)
        }
    }

    /// Adds what the last step changed, in the order of ids: each awake body, and once each body that fell asleep or
    /// was static and displaced.
    pub fn observe(&self, out: &mut Vec<Observation>) {
        out.extend_from_slice(&self.observations);
    }

    /// Adds every body as of the last step, in the order of ids; fixed ones as asleep. A body displaced since is at
    /// its old place, and is observed again after the next step.
    pub fn observe_all(&self, out: &mut Vec<Observation>) {
        let ids = self.registry.bodies().map(|desc| desc.id);
        let before = |id: &BodyId| self.displaced.get(id).copied();
        out.extend(ids.filter_map(|id| before(&id).or_else(|| self.engine.observe_one(id))));
    }

    /// The observations that [`Self::observe`] adds.
    #[must_use]
    pub fn observations(&self) -> &[Observation] {
        &self.observations
    }

    /// The observation of a body as of the last step, as [`Self::observe_all`] adds it.
    #[must_use]
    pub fn observation_at_tick(&self, id: BodyId) -> Option<Observation> {
        let displaced = self.displaced.get(&id).copied();
        displaced.or_else(|| self.observation(id))
    }

    /// The present observation of a body.
    #[must_use]
    pub fn observation(&self, id: BodyId) -> Option<Observation> {
        self.body(id)?;
        self.engine.observe_one(id)
    }

    /// Number of steps taken.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// The configuration of its creation.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// The present gravity, m/s².
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// Description of a body.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        self.registry.body(id)
    }

    /// Descriptions of all bodies, in the order of ids.
    pub fn bodies(&self) -> impl Iterator<Item = &BodyDesc> {
        self.registry.bodies()
    }

    /// Number of bodies.
    #[must_use]
    pub const fn body_count(&self) -> usize {
        self.registry.body_count()
    }

    /// Number of body indices that were ever used.
    pub(crate) const fn indices(&self) -> u32 {
        self.registry.indices()
    }

    /// Number of bodies awake after the last step.
    #[must_use]
    pub fn awake_count(&self) -> usize {
        self.engine.awake_count()
    }

    /// A shape by its id.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.registry.shape(id)
    }

    /// All shapes, in the order of ids.
    pub fn shapes(&self) -> impl Iterator<Item = (ShapeId, &Shape)> {
        self.registry.shapes()
    }

    /// The joints of the scene.
    #[must_use]
    pub const fn joints(&self) -> &Joints {
        self.registry.joints()
    }

    /// The shape of a body.
    #[must_use]
    pub fn shape_of(&self, id: BodyId) -> Option<&Shape> {
        self.shape(self.body(id)?.shape)
    }

    /// Radius of the least ball around a body's centre of mass that holds the body.
    #[must_use]
    pub fn bounding_radius(&self, id: BodyId) -> Option<Metres> {
        self.shape_of(id).map(Shape::bounding_radius)
    }

    /// Moments of inertia of a body that rotates torque-free: dynamic, gyroscopic, with unequal moments.
    #[must_use]
    pub fn inertia(&self, id: BodyId) -> Option<Inertia> {
        self.engine.inertia(id)
    }

    /// Adds one contact for each body that touches this one after the last step: the deepest.
    pub fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        self.engine.contacts(id, out);
    }

    /// The contacts and the stays in sensors after the last step, of the bodies that report events.
    pub(crate) fn standing_events(&self) -> Vec<BodyEvent> {
        self.event_monitor.standing(&*self.engine, &self.registry)
    }

    /// Answers queries by the poses of the last step.
    ///
    /// # Errors
    ///
    /// [`QueryError`] names the reason; none is answered then.
    pub fn query(&self, queries: &[Query]) -> Result<Vec<Answer>, QueryError> {
        for query in queries {
            query.check().map_err(QueryError::Invalid)?;
        }
        if !self.is_sound() {
            return Err(QueryError::SceneFaulted);
        }
        let answers = queries.iter().map(|query| match query.kind {
            QueryKind::Contacts { body } if self.engine.has_contacts() => {
                Ok(self.touching(body, query))
            }
            _ => self.engine.query(query),
        });
        answers
            .collect::<Result<_, _>>()
            .map_err(|_| QueryError::Unanswerable)
    }

    /// The bodies that touch a body and that a query considers, as the engine found them in the last step.
    fn touching(&self, body: BodyId, query: &Query) -> Answer {
        let mut contacts = Vec::new();
        self.contacts(body, &mut contacts);
        let counts = |contact: &Contact| {
            let other = self.body(contact.with);
            other.is_some_and(|desc| query.filter.takes(&QueryCandidate::of(desc)))
        };
        let hits = contacts.into_iter().filter(counts).map(|contact| Hit {
            body: contact.with,
            distance: contact.separation,
            point: contact.point,
            normal: contact.normal,
        });
        Answer::Hits(rhumb_solids::deepest(hits.collect(), query.hits))
    }

    /// The least generation that no body of an index has had.
    ///
    /// `None` while a body lives there, or when its generations are used up.
    #[must_use]
    pub fn vacancy(&self, index: u32) -> Option<u16> {
        self.registry.vacancy(index)
    }

    /// Digest of all observations so far.
    #[must_use]
    pub const fn digest(&self) -> Digest {
        self.digest
    }
}

/// The bound on bodies that overlap.
///
/// A step cannot be cancelled: one that would meet too many pairs of bodies for the first time is not begun, and a body
/// that would bring them is not added. A scene without the bound counts nothing, so that a log is replayed under any
/// limit.
impl Scene {
    /// Bounds the pairs of bodies that a step may meet for the first time, as the engine counts them.
    ///
    /// A body that brings more is refused. A step that other commands, or motion, bring more to fails with
    /// [`SceneFault::TooCrowded`], and nothing has changed.
    pub fn bound_crowding(&mut self, limit: u32) {
        self.crowding_max = Some(limit);
        self.engine.count_crowding(limit);
    }

    /// Refuses a step that would meet too many pairs.
    fn check_crowding(&mut self) -> Result<(), SceneFault> {
        let Some(limit) = self.crowding_max else {
            return Ok(());
        };
        let pairs = self.engine.crowding_ahead();
        match pairs > u64::from(limit) {
            true => Err(SceneFault::TooCrowded { pairs, limit }),
            false => Ok(()),
        }
    }

    /// Refuses a body that would bring too many pairs.
    fn check_crowding_with(
        &self,
        body: &BodyProperties,
        motion: &BodyState,
    ) -> Result<(), CommandError> {
        let Some(limit) = self.crowding_max else {
            return Ok(());
        };
        let pairs = self.engine.crowding() + self.engine.crowding_with(body, motion);
        if pairs > u64::from(limit) {
            return Err(CommandError::TooCrowded);
        }
        Ok(())
    }
}

/// Reason why a scene has stopped stepping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SceneFault {
    /// Its engine failed.
    Engine(EngineFault),
    /// So many bodies overlap that a step might not end.
    TooCrowded {
        /// Pairs of bodies, as [`Engine::crowding`] counts them.
        pairs: u64,
        /// The most that may be.
        limit: u32,
    },
}

impl fmt::Display for SceneFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Engine(fault) => write!(f, "the scene stands still: {fault}"),
            Self::TooCrowded { pairs, limit } => write!(
                f,
                "{pairs} pairs of bodies overlap beyond 32 of each body, and limits.scene_crowding is {limit}: its bodies must be further apart"
            ),
        }
    }
}

impl core::error::Error for SceneFault {}

impl From<EngineFault> for SceneFault {
    fn from(fault: EngineFault) -> Self {
        Self::Engine(fault)
    }
}

impl Scene {
    /// The function that makes the solid of a shape; `None` if the scene has no place for it under this id, and for an
    /// engine that makes solids only by itself.
    pub(crate) fn baker_for(&self, id: ShapeId, shape: &Shape) -> Option<Baker> {
        let has_place = self.registry.check_shape(id, shape).is_ok();
        self.engine.baker().filter(|_| has_place)
    }

    /// Keeps a solid for the next command that adds its shape.
    pub(crate) fn put_baked(
        &mut self,
        id: ShapeId,
        shape: &Shape,
        baked: Result<BakedShape, UnusableShape>,
    ) {
        self.baked.put(id, shape.clone(), baked);
    }
}

impl Scene {
    /// Refuses a dynamic body whose momentum the engine could not compute.
    fn check_moment(&self, properties: &BodyProperties) -> Result<(), CommandError> {
        let is_dynamic = properties.desc.kind == BodyKind::Dynamic;
        match self.engine.moment(properties).filter(|_| is_dynamic) {
            Some(moment) if !moment.is_finite() || moment > MOMENT_MAX => {
                let moments = Invalid::out_of_range(Quantity::Moments);
                Err(CommandError::Invalid(moments))
            }
            _ => Ok(()),
        }
    }

    /// A body's description with the scene's defaults filled in.
    fn properties(&self, desc: BodyDesc) -> BodyProperties {
        BodyProperties {
            desc,
            material: desc.material.unwrap_or(self.config.material),
            damping: desc.damping.unwrap_or(self.config.damping),
            sleep: desc.sleep.unwrap_or(self.config.sleep),
        }
    }
}

/// The digest of a run up to a tick.
///
/// State: 64 bits, at first [`Digest::START`]. A word w of 32 bits is folded by `s = (s xor w) · K mod 2⁶⁴`, then
/// `s = s xor (s >> 32)`, with K = 0x9e37_79b9_7f4a_7c15 (2⁶⁴ divided by the golden ratio, odd). A tick folds, in this
/// order: the lower and the upper half of its number, the count of observations; then for each observation, in the
/// order of ids: index, generation, the bits of its thirteen f32 (position x y z, quaternion x y z w, linear x y z,
/// angular x y z), and 1 if it is awake, 0 if it fell asleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Digest(u64);

impl Digest {
    /// The digest before the first tick.
    pub const START: Self = Self(0x7268_756d_6220_7631);

    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

    /// Folds in the observations after a tick.
    pub fn fold_tick(&mut self, tick: Tick, observations: &[Observation]) {
        self.fold(tick.value() as u32);
        self.fold((tick.value() >> 32) as u32);
        self.fold(observations.len() as u32);
        for observation in observations {
            self.fold(observation.id.index());
            self.fold(u32::from(observation.id.generation()));
            for part in observation.motion.parts() {
                self.fold(part.to_bits());
            }
            self.fold(match observation.activity {
                Activity::Awake => 1,
                Activity::Asleep => 0,
            });
        }
    }

    /// The digest of a run that continues from a snapshot.
    #[must_use]
    pub const fn from_value(value: u64) -> Self {
        Self(value)
    }

    /// The digest as a number.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }

    const fn fold(&mut self, word: u32) {
        let mixed = (self.0 ^ word as u64).wrapping_mul(Self::FACTOR);
        self.0 = mixed ^ (mixed >> 32);
    }
}

impl Default for Digest {
    fn default() -> Self {
        Self::START
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests;
