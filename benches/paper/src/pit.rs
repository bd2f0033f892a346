//! Scenes in the paper's frames: 1/11.33 s each, in six equal steps.
//!
//! A step is 1/67.98 s: the longest that divides a frame into whole steps and does not exceed 1/60 s. Streams publish
//! only the last tick of a frame, as the paper's engine did. A script is polled once per frame, before its first step.

use std::num::NonZeroU32;

use rhumb_protocol::scene::{Command, PublishSchedule, SceneConfig};
use rhumb_reckoning::{Rate, Tick, Ticks};
use rhumb_sims::{BallPit, Script};

/// Steps of a frame.
pub(crate) const STEPS: NonZeroU32 = NonZeroU32::new(6).expect("six is not zero");
/// Step rate: 11.33 frames per second of six steps each.
const RATE: Rate = Rate::new(6_798, 100).expect("neither is zero");
/// Frames per second.
pub(crate) const FRAMES_PER_SECOND: f64 = 11.33;

/// Converts a scene's config to frames.
pub(crate) fn in_frames(config: SceneConfig) -> SceneConfig {
    let mut config = config;
    config.integrator.rate = RATE;
    config.publish_schedule = PublishSchedule {
        publish_interval: STEPS,
        lookahead: Ticks::ZERO,
    };
    config
}

/// The number of bodies that commands place.
pub(crate) fn bodies_placed(commands: &[Command]) -> u32 {
    let placed = commands
        .iter()
        .filter(|command| matches!(command, Command::AddBody { .. }));
    placed.count() as u32
}

/// The ball pit that fills stage by stage.
pub(crate) struct Pit {
    script: BallPit,
    frames_per_load: u32,
}

impl Pit {
    /// Each of `stages` stages adds `balls_per_stage` balls and lasts `frames_per_load` frames.
    pub(crate) fn new(balls_per_stage: u32, stages: u32, frames_per_load: u32, seed: u64) -> Self {
        Self {
            script: BallPit::new(balls_per_stage, stages, seed),
            frames_per_load,
        }
    }

    pub(crate) fn config(&self) -> SceneConfig {
        in_frames(self.script.config())
    }

    /// Appends the commands before a frame, counted from 0; call it once per frame, in order.
    pub(crate) fn commands(&mut self, frame: u32, out: &mut Vec<Command>) {
        if frame.is_multiple_of(self.frames_per_load) {
            let stage = frame / self.frames_per_load;
            // The script counts its own ticks at 60 Hz.
            let cycle = u64::from(BallPit::CYCLE_SECONDS * 60);
            self.script
                .commands(Tick::new(u64::from(stage) * cycle), out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_the_papers_length_and_no_step_exceeds_a_sixtieth() {
        let config = Pit::new(500, 20, 340, 1).config();
        assert_eq!(config.check(), Ok(()));
        let step_s = config.integrator.rate.step().seconds();
        assert!(step_s <= 1.0 / 60.0);
        let frame_s = step_s * f64::from(config.publish_schedule.publish_interval.get());
        assert!((frame_s - 1.0 / FRAMES_PER_SECOND).abs() < 1e-12);
    }

    #[test]
    fn each_stage_adds_its_balls_in_its_first_frame_only() {
        let mut pit = Pit::new(50, 3, 7, 1);
        let mut added = Vec::new();
        for frame in 0..30 {
            let mut commands = Vec::new();
            pit.commands(frame, &mut commands);
            let bodies = commands
                .iter()
                .filter(|command| matches!(command, Command::AddBody { .. }));
            added.push(bodies.count());
        }
        let walls = added[0] - 50;
        assert!(walls > 0);
        for (frame, added) in added.iter().enumerate().skip(1) {
            assert_eq!(*added, if [7, 14].contains(&frame) { 50 } else { 0 });
        }
    }
}
