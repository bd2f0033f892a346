//! An engine that panics where a test wants it to.
//!
//! The server's own engine steps the world. Bodies of some collision groups stand for a fault of the engine: one panics
//! when it is added, others panic in a later step for as long as they are there.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::message::RemovalCause;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyEvent, BodyKind, CollisionGroups, Contact, Joint, JointId, JumpFrom,
    Locomotion, Query, SceneConfig, Shape, ShapeId, WheelInput,
};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Inertia, Twist};
use rhumb_scene::StepThreads;
use rhumb_scene::engine::{
    BodyProperties, Engine, EngineFault, Engines, Push, UnanswerableQuery, UnusableShape,
};

/// When a body makes the engine panic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fails {
    /// When it is added.
    Adding,
    /// In this step after it was added, counted from 1, and in every later one.
    Step(u32),
}

/// Marks the groups of a body that fails; the lower bits say when.
const MARK: u32 = 0xbad0_0000;

/// A body that makes a [`FailingEngine`] panic.
#[must_use]
pub fn failing_body(id: BodyId, shape: ShapeId, fails: Fails) -> BodyDesc {
    let when = match fails {
        Fails::Adding => 0,
        Fails::Step(step) => step,
    };
    BodyDesc {
        groups: CollisionGroups {
            members: MARK | when,
            touches: u32::MAX,
        },
        ..BodyDesc::plain(id, BodyKind::Dynamic, shape)
    }
}

/// The server's own engine, with faults.
pub struct FailingEngine {
    inner: Box<dyn Engine>,
    /// Steps before each body's panic.
    fuses: BTreeMap<BodyId, u32>,
    /// Panics in every step from then on.
    fails_after: Option<u64>,
    steps: u64,
}

impl FailingEngine {
    /// Engines that fail for their bodies only.
    #[must_use]
    pub fn engines() -> Engines {
        Self::engines_that_fail_after(None)
    }

    /// Engines that panic in every step after so many.
    #[must_use]
    pub fn engines_that_fail_after(fails_after: Option<u64>) -> Engines {
        Engines::new(move |config: &SceneConfig, workers: &StepThreads| {
            Ok(Box::new(Self {
                inner: Engines::default().make(config, workers)?,
                fuses: BTreeMap::new(),
                fails_after,
                steps: 0,
            }))
        })
    }
}

impl Engine for FailingEngine {
    fn add_shape(&mut self, id: ShapeId, shape: &Shape) -> Result<(), UnusableShape> {
        self.inner.add_shape(id, shape)
    }

    fn remove_shape(&mut self, id: ShapeId) {
        self.inner.remove_shape(id);
    }

    fn add(&mut self, body: &BodyProperties, motion: BodyState) {
        let members = body.desc.groups.members;
        if members & 0xffff_0000 == MARK {
            let steps = members & 0xffff;
            assert!(steps > 0, "the engine fails on the body");
            self.fuses.insert(body.desc.id, steps);
        }
        self.inner.add(body, motion);
    }

    fn change(&mut self, before: &BodyDesc, body: &BodyProperties) {
        self.inner.change(before, body);
    }

    fn remove(&mut self, id: BodyId) {
        self.fuses.remove(&id);
        self.inner.remove(id);
    }

    fn add_joint(&mut self, id: JointId, joint: &Joint) {
        self.inner.add_joint(id, joint);
    }

    fn remove_joint(&mut self, id: JointId) {
        self.inner.remove_joint(id);
    }

    fn overloaded_joints(&self, out: &mut Vec<JointId>) {
        self.inner.overloaded_joints(out);
    }

    fn set_pose(&mut self, id: BodyId, position: Vec3, rotation: Quat) {
        self.inner.set_pose(id, position, rotation);
    }

    fn set_velocity(&mut self, id: BodyId, twist: Twist) {
        self.inner.set_velocity(id, twist);
    }

    fn set_locomotion(&mut self, id: BodyId, locomotion: &Locomotion) {
        self.inner.set_locomotion(id, locomotion);
    }

    fn jump(&mut self, id: BodyId, speed: f32, from: JumpFrom) {
        self.inner.jump(id, speed, from);
    }

    fn set_wheels(&mut self, id: BodyId, inputs: &[WheelInput]) {
        self.inner.set_wheels(id, inputs);
    }

    fn ground_events(&self, out: &mut Vec<BodyEvent>) {
        self.inner.ground_events(out);
    }

    fn set_activity(&mut self, id: BodyId, activity: Activity) {
        self.inner.set_activity(id, activity);
    }

    fn effect(&self, id: BodyId, push: Push) -> Option<Twist> {
        self.inner.effect(id, push)
    }

    fn pending(&self, id: BodyId) -> Twist {
        self.inner.pending(id)
    }

    fn push(&mut self, id: BodyId, push: Push) {
        self.inner.push(id, push);
    }

    fn set_gravity(&mut self, gravity: Vec3) {
        self.inner.set_gravity(gravity);
    }

    fn step(&mut self, lost: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
        self.steps += 1;
        let steps = self.steps;
        assert!(
            self.fails_after.is_none_or(|after| steps <= after),
            "the engine fails in every step"
        );
        for steps in self.fuses.values_mut() {
            *steps = steps.saturating_sub(1);
            assert!(*steps > 0, "the engine fails in a step");
        }
        self.inner.step(lost)
    }

    fn observe(&self, out: &mut Vec<Observation>) {
        self.inner.observe(out);
    }

    fn observe_one(&self, id: BodyId) -> Option<Observation> {
        self.inner.observe_one(id)
    }

    fn inertia(&self, id: BodyId) -> Option<Inertia> {
        self.inner.inertia(id)
    }

    fn contacts(&self, id: BodyId, out: &mut Vec<Contact>) {
        self.inner.contacts(id, out);
    }

    fn sensed(&self, id: BodyId, out: &mut Vec<(BodyId, BodyId)>) {
        self.inner.sensed(id, out);
    }

    fn query(&self, query: &Query) -> Result<Answer, UnanswerableQuery> {
        self.inner.query(query)
    }

    fn awake_count(&self) -> usize {
        self.inner.awake_count()
    }

    fn fault(&self) -> Option<EngineFault> {
        self.inner.fault()
    }

    fn copy(&self) -> Option<Box<dyn Engine>> {
        Some(Box::new(Self {
            inner: self.inner.copy()?,
            fuses: self.fuses.clone(),
            fails_after: self.fails_after,
            steps: self.steps,
        }))
    }
}
