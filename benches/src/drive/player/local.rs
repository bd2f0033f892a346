//! Player that steps the engine in the caller's thread: the baseline of time.

use std::hint::black_box;

use rhumb_protocol::scene::Command;
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_server::{Scene, Workers};
use rhumb_transport::Clock;

use super::interface::{
    FrameCost, Player, PlayerFactory, PlayerSetup, PlayerTotals, Stages, Traffic,
};
use crate::drive::error::DriveError;
use crate::processor::work_ns;
use crate::record::Mode;

/// A scene in this process and every body's newest state, as a simulator keeps it.
struct LocalPlayer {
    scene: Scene,
    /// Steps per frame.
    steps: u32,
    clock: Clock,
    states: Vec<Option<(BodyId, BodyState)>>,
    stages: Stages,
}

/// Factory of players in the caller's thread.
pub(super) struct InThread;

impl PlayerFactory for InThread {
    fn start(&self, player_setup: &PlayerSetup, _: Mode) -> Result<Box<dyn Player>, DriveError> {
        let threads = player_setup.cpu.threads;
        let workers = Workers::new(threads).map_err(DriveError::Workers)?;
        let scene = Scene::on(player_setup.config, &workers).map_err(DriveError::Config)?;
        Ok(Box::new(LocalPlayer {
            scene,
            steps: player_setup.config.publish_schedule.publish_interval.get(),
            clock: Clock::start(),
            states: Vec::new(),
            stages: Stages::default(),
        }))
    }
}

impl LocalPlayer {
    fn apply(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        for command in commands {
            self.scene.apply(command).map_err(DriveError::Refused)?;
            match *command {
                Command::AddBody { desc, motion } => self.remember(desc.id, motion),
                Command::RemoveBody { id } => self.forget(id),
                _ => {}
            }
        }
        Ok(())
    }

    fn remember(&mut self, id: BodyId, motion: BodyState) {
        let index = id.index() as usize;
        if index >= self.states.len() {
            self.states.resize(index + 1, None);
        }
        self.states[index] = Some((id, motion));
    }

    fn forget(&mut self, id: BodyId) {
        if let Some(state) = self.states.get_mut(id.index() as usize) {
            *state = None;
        }
    }

    /// One step. Of the steps between frames only bodies that fall asleep are read, because later steps do not list
    /// them again.
    fn step(&mut self, last: LastStep) -> Result<(), DriveError> {
        let begun = self.clock.now();
        let stepped = self.scene.step().map_err(DriveError::Scene)?;
        let after = self.clock.now();
        for (id, _) in stepped.removed {
            self.forget(id);
        }
        let Self { scene, states, .. } = self;
        for observation in scene.observations() {
            if last == LastStep::Yes || observation.activity == Activity::Asleep {
                states[observation.id.index() as usize] =
                    Some((observation.id, observation.motion));
            }
        }
        self.stages.step_ns += after.since(begun).as_nanos();
        self.stages.observe_ns += self.clock.now().since(after).as_nanos();
        Ok(())
    }
}

/// The position of a step in its frame: the last one, or one before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LastStep {
    Yes,
    No,
}

impl Player for LocalPlayer {
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.apply(commands)
    }

    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError> {
        let work = work_ns();
        let begun = self.clock.now();
        self.apply(commands)?;
        for _ in 1..self.steps {
            self.step(LastStep::No)?;
        }
        self.step(LastStep::Yes)?;
        for (_, motion) in self.states.iter().flatten() {
            black_box((motion.position(), motion.rotation()));
        }
        let wall_ns = self.clock.now().since(begun).as_nanos();
        let work_ns = work_ns().zip(work).map(|(after, before)| after - before);
        Ok(FrameCost { wall_ns, work_ns })
    }

    fn totals(&mut self) -> Result<PlayerTotals, DriveError> {
        Ok(PlayerTotals {
            tick: self.scene.tick(),
            truth: self.scene.digest().value(),
            awake: self.scene.awake_count() as u32,
            stages: self.stages,
            traffic: Traffic::default(),
            ends_lost: 0,
        })
    }
}
