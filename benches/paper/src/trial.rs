//! One trial: all modes in turn, frame by frame, while the pit fills.
//!
//! One mode runs at a time, because cores of a processor share caches and memory and would slow each other. The modes
//! take turns at being first. A pipelined mode comes last: its caller then does other work for as long as the
//! integrated frame took, and a pause follows in which its server finishes.
//!
//! A frame has 1/11.33 s in six equal steps of 1/67.98 s: the longest step that divides a frame and does not exceed
//! 1/60 s. Streams publish only the last tick of a frame, as the paper's engine did. A script is polled once per
//! frame, before its first step.

use std::num::NonZeroU32;

use rhumb_bench::drive::player::{self, FrameCost, Player, PlayerSetup, PlayerTotals};
use rhumb_bench::drive::{Defects, ServerCpu};
use rhumb_bench::numbers::of_nanoseconds;
use rhumb_bench::record::Mode;
use rhumb_protocol::Span;
use rhumb_protocol::scene::{Command, PublishSchedule, SceneConfig};
use rhumb_reckoning::{Rate, Tick, Ticks};
use rhumb_sims::{BallPit, Script};
use rhumb_transport::Clock;

use crate::processor::{Weakness, pause, work};
use crate::settings::{ExperimentTrial, LoadOutcome, ModeOutcome, PaperError, Settings};

/// Progress of a trial.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TrialProgress<'t> {
    /// Balls in the pit.
    pub(crate) load: u32,
    /// Share of a processor that the caller gets, as text.
    pub(crate) caller: &'t str,
}

/// The servers and the modes of a trial.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Staging<'t> {
    pub(crate) cpu: &'t ServerCpu,
    pub(crate) modes: &'t [Mode],
    /// Percentage of a processor that the caller gets once the servers run; 100 means no limit.
    pub(crate) caller_percent: u32,
}

/// A player of one mode during a trial.
struct TrialRunner {
    mode: Mode,
    player: Box<dyn Player>,
    /// Costs of the frames of this load.
    frame_cost: Vec<FrameCost>,
    before: PlayerTotals,
}

/// Divisor of the integrated frame time for the pause after a caller's other work, in which its server finishes.
const PAUSE_PART: u64 = 2;

/// Runs a trial; calls `progress` after each frame.
pub(crate) fn run(
    settings: &Settings,
    number: u32,
    staging: &Staging<'_>,
    progress: &mut dyn FnMut(TrialProgress<'_>),
) -> Result<ExperimentTrial, PaperError> {
    let clock = Clock::start();
    let seed = settings.seed_of(number);
    let stages = settings.loads.len() as u32;
    let first = settings.loads.first().copied().unwrap_or_default();
    let mut pit = Pit::new(first, stages, settings.frames_per_load, seed);
    let mut commands = Vec::new();
    pit.commands(0, &mut commands);
    let player_setup = PlayerSetup {
        config: pit.config(),
        bodies: bodies_placed(&commands) + first * (stages - 1),
        tolerance: crate::settings::tolerance(settings.tolerance_m)?,
        defects: Defects::SOUND,
        cpu: staging.cpu.clone(),
        seed,
    };
    let mut runners = begin(staging.modes, &player_setup, &commands)?;
    // Only now, because child processes inherit the limit.
    let weakness = match staging.caller_percent {
        100 => None,
        percent => Some(Weakness::enter(percent)?),
    };
    let whole = || "all of a processor".to_owned();
    let caller = weakness.as_ref().map_or_else(whole, Weakness::describe);
    commands.clear();
    let mut loads = Vec::new();
    for (stage, load) in (0..).zip(&settings.loads) {
        for frame in 0..settings.frames_per_load {
            let number = stage * settings.frames_per_load + frame;
            if number > 0 {
                commands.clear();
                pit.commands(number, &mut commands);
            }
            one_frame(&clock, &mut runners, &commands)?;
            progress(TrialProgress {
                load: *load,
                caller: &caller,
            });
        }
        loads.push(LoadOutcome {
            load: *load,
            modes: outcomes(&mut runners, staging.modes)?,
        });
    }
    Ok(ExperimentTrial {
        number,
        seed,
        wall_s: clock.now().as_nanos() as f64 / 1e9,
        loads,
    })
}

/// Starts every mode, in the order of turns, and sends its first commands.
fn begin(
    modes: &[Mode],
    player_setup: &PlayerSetup,
    commands: &[Command],
) -> Result<Vec<TrialRunner>, PaperError> {
    let mut runners = Vec::new();
    for mode in modes {
        let started = player::start(*mode, player_setup);
        let mut player = started.ok_or(PaperError::NotPlayable { mode: *mode })??;
        player.prepare(commands)?;
        let before = player.totals()?;
        runners.push(TrialRunner {
            mode: *mode,
            player,
            frame_cost: Vec::new(),
            before,
        });
    }
    runners.sort_by_key(|runner| (runner.mode.is_ahead(), runner.mode != Mode::Integrated));
    Ok(runners)
}

fn one_frame(
    clock: &Clock,
    runners: &mut [TrialRunner],
    commands: &[Command],
) -> Result<(), PaperError> {
    // Rotate the order: the first mode starts with cold caches or an idle core.
    let waiting = runners.iter().filter(|runner| !runner.mode.is_ahead());
    let waiting = waiting.count();
    runners[..waiting].rotate_left(1);
    let mut integrated_ns = 0;
    for runner in runners {
        let frame_cost = runner.player.frame(commands)?;
        if runner.mode == Mode::Integrated {
            integrated_ns = frame_cost.wall_ns;
        }
        if runner.mode.is_ahead() {
            work(clock, Span::from_nanos(integrated_ns));
            pause(clock, Span::from_nanos(integrated_ns / PAUSE_PART));
        }
        runner.frame_cost.push(frame_cost);
    }
    Ok(())
}

/// Outcome of each mode since the last load, in the order of the settings.
fn outcomes(runners: &mut [TrialRunner], modes: &[Mode]) -> Result<Vec<ModeOutcome>, PaperError> {
    let mut truth = None;
    let mut found = Vec::new();
    for runner in runners.iter_mut() {
        let totals = runner.player.totals()?;
        if runner.mode == Mode::Integrated {
            truth = Some((totals.tick, totals.truth));
        }
        let frame_cost = std::mem::take(&mut runner.frame_cost);
        let outcome = outcome(runner.mode, &frame_cost, &runner.before, &totals);
        runner.before = totals;
        found.push((runner.mode, (totals.tick, totals.truth), outcome));
    }
    for (_, own, outcome) in &mut found {
        outcome.void = truth != Some(*own);
    }
    found.sort_by_key(|(mode, ..)| modes.iter().position(|other| other == mode));
    Ok(found.into_iter().map(|(.., outcome)| outcome).collect())
}

/// The figures of a series of frames.
pub(crate) fn outcome(
    mode: Mode,
    frame_cost: &[FrameCost],
    before: &PlayerTotals,
    after: &PlayerTotals,
) -> ModeOutcome {
    let frames = frame_cost.len().max(1) as f64;
    let mut walls: Vec<u64> = frame_cost
        .iter()
        .map(|frame_cost| frame_cost.wall_ns)
        .collect();
    let percentile =
        |values: &mut Vec<u64>, percent| of_nanoseconds(values, percent).map_or(0.0, milliseconds);
    let mean_ms = milliseconds(walls.iter().sum::<u64>()) / frames;
    let work: Option<u64> = frame_cost.iter().map(|frame_cost| frame_cost.work_ns).sum();
    let per_frame = |of: fn(&PlayerTotals) -> u64| milliseconds(of(after) - of(before)) / frames;
    let (step_ms, observe_ms, publish_ms) = (
        per_frame(|totals| totals.stages.step_ns),
        per_frame(|totals| totals.stages.observe_ns),
        per_frame(|totals| totals.stages.publish_ns),
    );
    let sim_fps = sim_fps(frame_cost);
    let server_ms = step_ms + observe_ms + publish_ms;
    let sustained = if mode.is_ahead() {
        sim_fps.min(1e3 / server_ms)
    } else {
        sim_fps
    };
    let since = |of: fn(&PlayerTotals) -> u64| of(after) - of(before);
    ModeOutcome {
        mode: mode.name().to_owned(),
        frames: frame_cost.len() as u32,
        phys_ft_ms: mean_ms,
        phys_ft_p50_ms: percentile(&mut walls, 50),
        phys_ft_p99_ms: percentile(&mut walls, 99),
        phys_ft_max_ms: percentile(&mut walls, 100),
        work_ms: work.map(|work| milliseconds(work) / frames),
        sim_fps,
        sustained_fps: sustained,
        step_ms,
        observe_ms,
        publish_ms,
        awake: after.awake,
        bytes_down: since(|totals| totals.traffic.bytes_down),
        bytes_up: since(|totals| totals.traffic.bytes_up),
        datagrams_down: since(|totals| totals.traffic.datagrams_down),
        updates: since(|totals| totals.traffic.updates),
        ends_lost: since(|totals| totals.ends_lost),
        truth: format!("{:016x}", after.truth),
        void: false,
    }
}

/// Frames over their time; a frame lasts at least as long as the simulated time that it covers.
fn sim_fps(frame_cost: &[FrameCost]) -> f64 {
    let least_s = 1.0 / FRAMES_PER_SECOND;
    let lasted: f64 = frame_cost
        .iter()
        .map(|frame_cost| (frame_cost.wall_ns as f64 / 1e9).max(least_s))
        .sum();
    if lasted > 0.0 {
        frame_cost.len() as f64 / lasted
    } else {
        0.0
    }
}

fn milliseconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e6
}

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
    use rhumb_bench::drive::player::Stages;

    use super::*;

    fn frame_cost(wall_ms: u64) -> FrameCost {
        FrameCost {
            wall_ns: wall_ms * 1_000_000,
            work_ns: Some(wall_ms * 500_000),
        }
    }

    #[test]
    fn a_fast_frame_does_not_compensate_a_slow_one() {
        assert!((sim_fps(&[frame_cost(1), frame_cost(2)]) - FRAMES_PER_SECOND).abs() < 1e-9);
        // One frame of 1 ms lasts 88.26 ms, the other 200: two frames in 288.26 ms.
        assert!((sim_fps(&[frame_cost(1), frame_cost(200)]) - 6.938_2).abs() < 1e-4);
        assert_eq!(sim_fps(&[]), 0.0);
    }

    #[test]
    fn a_pipelined_caller_sustains_no_more_than_its_server() {
        let stages = Stages {
            step_ns: 380_000_000,
            observe_ns: 10_000_000,
            publish_ns: 10_000_000,
        };
        let after = PlayerTotals {
            stages,
            ..PlayerTotals::default()
        };
        let frames = [frame_cost(1), frame_cost(1)];
        let ahead = outcome(
            Mode::RhumbPipelined,
            &frames,
            &PlayerTotals::default(),
            &after,
        );
        assert!((ahead.sim_fps - FRAMES_PER_SECOND).abs() < 1e-9);
        assert!((ahead.sustained_fps - 5.0).abs() < 1e-9);
        assert_eq!((ahead.step_ms, ahead.publish_ms), (190.0, 5.0));
        assert_eq!((ahead.phys_ft_ms, ahead.work_ms), (1.0, Some(0.5)));
        let waits = outcome(Mode::Rhumb, &frames, &PlayerTotals::default(), &after);
        assert!((waits.sustained_fps - FRAMES_PER_SECOND).abs() < 1e-9);
    }

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
