//! Runs the modes that step in turn: integrated, naive and predicted.
//!
//! The integrated scene steps in this thread: it is the truth and the baseline of time. Each tick, the pipelined
//! client requests its next tick. While its server works, the integrated scene takes the tick, then the other modes
//! take it. So the pipelined caller has other work to do, as a simulator has.

use std::hint::black_box;

use rhumb_client::{PipelineDepth, StreamChoice};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::scene::{Command, PublishSchedule};
use rhumb_protocol::stream::{Budget, Observation, PredictionParameters};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Ticks, Tolerance};
use rhumb_scene::{Hook, Scene};
use rhumb_sims::Script;
use rhumb_trace::SceneFacts;
use rhumb_transport::Clock;

use super::app::{AppRemote, AppSetup, Defects};
use super::compare::{RecentTruth, TrueBody};
use super::process::{ScriptChoice, ServerCpu, hook};
use super::remote::{Remote, Retention, Setup};
use crate::drive::DriveError;
use crate::numbers::of_nanoseconds;
use crate::record::{
    Frame, JoinCost, Load, Mode, Placed, Run, RunConfig, SubscriptionSettings, Truth,
};

/// Cores of the caller and of the servers, where there are two.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cores {
    /// Core of all servers.
    pub server: Option<usize>,
}

/// Settings of an evaluation.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Name of the script.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u32,
    /// Seed of the script.
    pub seed: u64,
    /// Number of ticks.
    pub ticks: u32,
    /// Tolerance of the predicted modes.
    pub tolerance: Tolerance,
    /// Bandwidth limit of the predicted modes, if any.
    pub budget: Option<Budget>,
    /// Simulated link between the processes.
    pub link: LinkConfig,
    /// Modes to run, in the order of the report.
    pub modes: Vec<Mode>,
    /// Defects of the client of the paper's protocol.
    pub defects: Defects,
    /// Publish schedule of the free-running scene.
    pub publish_schedule: PublishSchedule,
    /// Ticks by which a free-running view lags behind the newest tick that can be shown.
    pub delay: Ticks,
    /// Cores of caller and servers.
    pub cores: Cores,
}

impl Plan {
    pub(super) fn script(&self) -> Result<Box<dyn Script>, DriveError> {
        let script = self.script_choice().script();
        script.ok_or_else(|| DriveError::NoSuchScene {
            name: self.scene.clone(),
        })
    }

    fn script_choice(&self) -> ScriptChoice {
        ScriptChoice {
            scene: self.scene.clone(),
            bodies: self.bodies,
            seed: self.seed,
        }
    }

    pub(super) fn run_config(&self, mode: Mode, step_s: f64) -> RunConfig {
        let predicts = matches!(mode, Mode::Rhumb | Mode::RhumbPipelined | Mode::RhumbFree);
        let length = self.tolerance.length().filter(|_| predicts);
        RunConfig {
            scene: self.scene.clone(),
            bodies: self.bodies,
            mode,
            depth: u32::from(mode == Mode::RhumbPipelined),
            tolerance_m: length.map(Metres::metres),
            budget_bytes_per_second: self
                .budget
                .filter(|_| predicts)
                .map(Budget::bytes_per_second),
            link: if mode == Mode::Integrated {
                "none".into()
            } else if mode.is_app() {
                format!("{}, client {}", LinkConfig::PERFECT, self.defects)
            } else {
                self.link.to_string()
            },
            seed: self.seed,
            step_s,
            ticks: self.ticks,
            subscription: mode.is_free().then(|| SubscriptionSettings {
                publish_interval: self.publish_schedule.publish_interval.get(),
                lookahead_ticks: self.publish_schedule.lookahead.count(),
                delay_ticks: self.delay.count(),
            }),
            replayed: None,
            limit: None,
        }
    }

    /// Starts the modes with a Rhumb client in lockstep or pipelined. The pipelined one comes first, because its
    /// server works while the others take their turn.
    fn start_remotes(&self, script: &dyn Script) -> Result<Vec<(Mode, Remote)>, DriveError> {
        let mut remotes = Vec::new();
        for mode in &self.modes {
            if *mode != Mode::Integrated && !mode.is_free() && !mode.is_app() {
                remotes.push((*mode, Remote::start(&self.setup(*mode, script))?));
            }
        }
        remotes.sort_by_key(|(mode, _)| *mode != Mode::RhumbPipelined);
        Ok(remotes)
    }

    /// Starts the modes of the paper's protocol.
    fn start_apps(&self, script: &dyn Script) -> Result<Vec<(Mode, AppRemote)>, DriveError> {
        let modes = self.modes.iter().copied().filter(|mode| mode.is_app());
        modes
            .map(|mode| {
                let setup = AppSetup {
                    mode,
                    defects: self.defects,
                    config: script.config(),
                    controller_script: script.controller().map(|_| self.script_choice()),
                    cpu: ServerCpu::on(self.cores.server),
                    keep: Retention::Everything,
                };
                Ok((mode, AppRemote::start(&setup)?))
            })
            .collect()
    }

    pub(super) fn setup<'a>(&'a self, mode: Mode, script: &dyn Script) -> Setup<'a> {
        Setup {
            stream: match mode {
                Mode::Naive | Mode::NaiveFree => StreamChoice::Full,
                _ => match self.budget {
                    Some(budget) => StreamChoice::Capped {
                        tolerance: self.tolerance,
                        budget,
                    },
                    None => StreamChoice::Within(self.tolerance),
                },
            },
            delay: if mode.is_free() {
                self.delay
            } else {
                Ticks::ZERO
            },
            depth: match mode {
                Mode::RhumbPipelined => PipelineDepth::PIPELINED,
                _ => PipelineDepth::LOCKSTEP,
            },
            config: script.config(),
            controller_script: script.controller().map(|_| self.script_choice()),
            cpu: ServerCpu::on(self.cores.server),
            link: &self.link,
            seed: self.seed,
            bodies: 0,
            keep: Retention::Everything,
        }
    }
}

/// Runs all modes of a plan except the free-running ones; calls `progress` after each tick.
///
/// # Errors
///
/// [`DriveError`] names the failure; a run that fails leaves no results.
pub fn run_side_by_side(plan: &Plan, progress: &mut dyn FnMut(Tick)) -> Result<Load, DriveError> {
    let mut script = plan.script()?;
    let mut integrated = Integrated::new(&*script)?;
    let mut remotes = plan.start_remotes(&*script)?;
    let mut apps = plan.start_apps(&*script)?;
    let mut recent = RecentTruth::default();
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in &commands {
        integrated.apply(command)?;
    }
    for (_, remote) in &mut remotes {
        remote.prepare(&commands)?;
    }
    for (_, app) in &mut apps {
        app.prepare(&commands)?;
    }
    remember(&mut recent, &integrated);
    commands.clear();
    let mut frames = Vec::new();
    for number in 1..=plan.ticks {
        let pipelined = remotes
            .first()
            .is_some_and(|(mode, _)| *mode == Mode::RhumbPipelined);
        let (first, others) = remotes.split_at_mut(usize::from(pipelined));
        for (_, remote) in first.iter_mut() {
            remote.frame(&commands)?;
        }
        for command in &commands {
            integrated.apply(command)?;
        }
        let frame_ns = integrated.frame()?;
        frames.push(Frame {
            tick: integrated.tick(),
            frame_ns,
            ..Frame::default()
        });
        remember(&mut recent, &integrated);
        for (_, remote) in others {
            remote.frame(&commands)?;
        }
        frame_of_apps(&mut apps, &commands, &recent, integrated.tick())?;
        for (mode, remote) in &mut remotes {
            let tolerance = (*mode != Mode::Naive).then_some(plan.tolerance);
            let missing = remote.record_errors(&recent, tolerance);
            // A pipelined copy may learn of a removal before it shows the last tick that had the body.
            let allowed = *mode == Mode::RhumbPipelined && missing.is_some();
            if missing != Some(0) && !allowed {
                let tick = integrated.tick();
                return Err(DriveError::Incomplete { mode: *mode, tick });
            }
        }
        progress(integrated.tick());
        commands.clear();
        if number < plan.ticks {
            script.commands(integrated.tick(), &mut commands);
        }
    }
    show_last_pipelined_tick(plan, &recent, integrated.tick(), &mut remotes)?;
    let apps = apps
        .into_iter()
        .map(|(mode, app)| finish_app(plan, mode, app, &integrated))
        .collect::<Result<Vec<_>, _>>()?;
    let mut load = finish(plan, integrated, frames, remotes)?;
    load.runs.extend(apps);
    load.runs
        .sort_by_key(|run| plan.modes.iter().position(|mode| *mode == run.config.mode));
    Ok(load)
}

/// Takes a tick in each mode of the paper's protocol and records its errors.
fn frame_of_apps(
    apps: &mut [(Mode, AppRemote)],
    commands: &[Command],
    recent: &RecentTruth,
    tick: Tick,
) -> Result<(), DriveError> {
    for (mode, app) in apps {
        app.frame(commands)?;
        if app.record_errors(recent) != Some(0) {
            return Err(DriveError::Incomplete { mode: *mode, tick });
        }
    }
    Ok(())
}

fn finish_app(
    plan: &Plan,
    mode: Mode,
    mut app: AppRemote,
    integrated: &Integrated,
) -> Result<Run, DriveError> {
    let step_s = integrated.scene().config().integrator.rate.step().seconds();
    let inspection = app.inspect()?;
    Ok(Run {
        config: plan.run_config(mode, step_s),
        truth_checksum: inspection.truth,
        frames: app.frames,
        captured: app.captured,
        join: app.join,
        breaches: Vec::new(),
        recoveries: Vec::new(),
        // The paper's protocol has no track checksums.
        mismatches: 0,
        step_ns_p50: inspection.times.step_median,
        step_ns_p99: inspection.times.step_p99,
        step_ns_total: inspection.times.step_total,
        publish_ns_total: inspection.times.publish_total + inspection.times.observe_total,
    })
}

/// Shows the last tick of a pipelined server.
fn show_last_pipelined_tick(
    plan: &Plan,
    recent: &RecentTruth,
    tick: Tick,
    remotes: &mut [(Mode, Remote)],
) -> Result<(), DriveError> {
    let pipelined = |(mode, _): &&mut (Mode, Remote)| *mode == Mode::RhumbPipelined;
    for (mode, remote) in remotes.iter_mut().filter(pipelined) {
        remote.last_frame()?;
        if remote.record_errors(recent, Some(plan.tolerance)) != Some(0) {
            return Err(DriveError::Incomplete { mode: *mode, tick });
        }
    }
    Ok(())
}

/// Keeps the states of all bodies at the newest tick.
fn remember(recent: &mut RecentTruth, integrated: &Integrated) {
    let scene = integrated.scene();
    let known = integrated.states().iter().map(|state| {
        let (id, motion) = (*state)?;
        let config = scene.body(id)?;
        Some(TrueBody {
            id,
            motion,
            radius: scene.bounding_radius(id)?,
            kind: config.kind,
            tolerance_scale: config.tolerance_scale,
        })
    });
    recent.push(integrated.tick(), known);
}

fn finish(
    plan: &Plan,
    integrated: Integrated,
    frames: Vec<Frame>,
    remotes: Vec<(Mode, Remote)>,
) -> Result<Load, DriveError> {
    let step_s = integrated.scene().config().integrator.rate.step().seconds();
    let mut runs = Vec::new();
    let mut steps = integrated.steps_ns.clone();
    let mut share = |percent| of_nanoseconds(&mut steps, percent).unwrap_or(0);
    let (step_ns_p50, step_ns_p99) = (share(50), share(99));
    if plan.modes.contains(&Mode::Integrated) {
        runs.push(Run {
            config: plan.run_config(Mode::Integrated, step_s),
            truth_checksum: integrated.truth.digest,
            frames,
            captured: Vec::new(),
            join: JoinCost::default(),
            breaches: Vec::new(),
            recoveries: Vec::new(),
            step_ns_p50,
            step_ns_p99,
            step_ns_total: steps.iter().sum(),
            publish_ns_total: 0,
            mismatches: 0,
        });
    }
    for (mode, mut remote) in remotes {
        let (inspection, mismatches) = (remote.inspect()?, remote.mismatches());
        runs.push(Run {
            config: plan.run_config(mode, step_s),
            truth_checksum: inspection.truth,
            frames: remote.frames,
            captured: remote.captured,
            join: remote.join,
            breaches: remote.breaches,
            recoveries: Vec::new(),
            step_ns_p50: inspection.times.step_median,
            step_ns_p99: inspection.times.step_p99,
            step_ns_total: inspection.times.step_total,
            publish_ns_total: inspection.times.publish_total + inspection.times.observe_total,
            mismatches,
        });
    }
    Ok(Load {
        facts: SceneFacts::of(integrated.scene().config()),
        truth: integrated.truth,
        runs,
        unfinished: Vec::new(),
    })
}

/// An engine in this process and the record of its states.
pub(super) struct Integrated {
    scene: Scene,
    hook: Option<Hook>,
    clock: Clock,
    pub(super) truth: Truth,
    /// Newest state of each body, by index; the simulator reads it every frame.
    states: Vec<Option<(BodyId, BodyState)>>,
    observations: Vec<Observation>,
    steps_ns: Vec<u64>,
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
