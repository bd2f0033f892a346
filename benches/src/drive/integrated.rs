//! The scene stepped in the caller's thread: truth and time baseline.

use std::hint::black_box;

use rhumb_protocol::scene::Command;
use rhumb_protocol::stream::{Observation, PredictionParameters};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_server::{Hook, Scene};
use rhumb_sims::Script;
use rhumb_transport::Clock;

use super::control::hook;
use super::error::DriveError;
use crate::record::{Placed, Truth};

/// An engine in this process and the record of its states.
pub(super) struct Integrated {
    scene: Scene,
    hook: Option<Hook>,
    clock: Clock,
    pub(super) truth: Truth,
    /// Newest state of each body, by index; the simulator reads it every frame.
    states: Vec<Option<(BodyId, BodyState)>>,
    observations: Vec<Observation>,
    pub(super) steps_ns: Vec<u64>,
}

impl Integrated {
    /// The empty scene of a script, with its controller attached.
    pub(super) fn new(script: &dyn Script) -> Result<Self, DriveError> {
        let scene = Scene::new(script.config()).map_err(DriveError::Config)?;
        Ok(Self {
            scene,
            hook: script.controller().map(hook),
            clock: Clock::start(),
            truth: Truth::default(),
            states: Vec::new(),
            observations: Vec::new(),
            steps_ns: Vec::new(),
        })
    }

    /// Applies a command and records placements and removals.
    pub(super) fn apply(&mut self, command: &Command) -> Result<(), DriveError> {
        self.scene.apply(command).map_err(DriveError::Refused)?;
        let tick = self.scene.tick();
        match *command {
            Command::AddBody { desc, .. } => {
                let observation = self.scene.observation(desc.id);
                let shape = self.scene.shape_of(desc.id).cloned();
                if let (Some(observation), Some(shape)) = (observation, shape) {
                    self.remember(&observation);
                    let (damping, known) =
                        (self.scene.config().damping, self.scene.inertia(desc.id));
                    let inertia = PredictionParameters::of(&desc, &shape, damping, known).inertia;
                    self.truth.placed.push(Placed {
                        tick,
                        desc,
                        shape,
                        observation,
                        inertia,
                    });
                }
            }
            Command::RemoveBody { id } => {
                self.states[id.index() as usize] = None;
                self.truth.removed.push((tick, id));
            }
            _ => {}
        }
        Ok(())
    }

    fn remember(&mut self, observation: &Observation) {
        let index = observation.id.index() as usize;
        if index >= self.states.len() {
            self.states.resize(index + 1, None);
        }
        self.states[index] = Some((observation.id, observation.motion));
    }

    /// One frame of an integrated simulator: step, then read every pose. Returns its duration in nanoseconds.
    pub(super) fn frame(&mut self) -> Result<u64, DriveError> {
        let begun = self.clock.now();
        let hook = self.hook.as_mut();
        let refused = hook.map(|hook| hook.act(&mut self.scene));
        let stepped = self.scene.step().map_err(DriveError::Scene)?;
        let after_step = self.clock.now();
        if let Some(error) = refused.iter().flatten().next() {
            return Err(DriveError::Controller(*error));
        }
        for (id, _) in &stepped.removed {
            self.states[id.index() as usize] = None;
        }
        self.observations.clear();
        self.scene.observe(&mut self.observations);
        let observations = std::mem::take(&mut self.observations);
        for observation in &observations {
            self.remember(observation);
        }
        for (_, motion) in self.states.iter().flatten() {
            black_box((motion.position(), motion.rotation()));
        }
        let ended = self.clock.now();
        for (id, _) in stepped.removed {
            self.truth.removed.push((stepped.tick, id));
        }
        self.truth.ticks.push(observations);
        self.truth.digest = self.scene.digest().value();
        self.steps_ns.push(after_step.since(begun).as_nanos());
        Ok(ended.since(begun).as_nanos())
    }

    pub(super) fn tick(&self) -> Tick {
        self.scene.tick()
    }

    pub(super) fn states(&self) -> &[Option<(BodyId, BodyState)>] {
        &self.states
    }

    pub(super) fn scene(&self) -> &Scene {
        &self.scene
    }
}
