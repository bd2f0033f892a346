//! Players: modes that step in turn and record only their cost.
//!
//! A frame covers the steps between two published ticks. A player keeps only the cost of a frame, neither poses nor
//! packets, so memory does not grow with the length of a run. One player steps the engine in the caller's thread, the
//! baseline of time; the others have a server process and a client.

use std::hint::black_box;

use rhumb_client::{PipelineDepth, StreamChoice};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::message::{Inspection, StageTimes};
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_protocol::stream::Activity;
use rhumb_reckoning::{BodyId, BodyState, Tick, Ticks, Tolerance};
use rhumb_scene::{Scene, StepThreads};
use rhumb_transport::Clock;

use super::app::{AppRemote, AppSetup, Defects};
use super::process::ServerCpu;
use super::remote::{Remote, Retention, Setup};
use crate::drive::DriveError;
use crate::machine::work_ns;
use crate::record::{Frame, Mode};
use crate::summary::DATAGRAM_HEADER_BYTES;

/// A playable mode and its factory.
pub struct Playable {
    /// The mode.
    pub mode: Mode,
    player_factory: &'static (dyn PlayerFactory + Sync),
}

/// All playable modes in the order of reports; adding a mode takes one entry.
const PLAYABLE: &[Playable] = &[
    Playable {
        mode: Mode::Integrated,
        player_factory: &InThread,
    },
    Playable {
        mode: Mode::AppAll,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::AppActive,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::AppPacked,
        player_factory: &OverApp,
    },
    Playable {
        mode: Mode::Naive,
        player_factory: &OverRhumb,
    },
    Playable {
        mode: Mode::Rhumb,
        player_factory: &OverRhumb,
    },
    Playable {
        mode: Mode::RhumbPipelined,
        player_factory: &OverRhumb,
    },
];

/// The playable modes, in the order of reports.
pub fn playable() -> impl Iterator<Item = Mode> {
    PLAYABLE.iter().map(|playable| playable.mode)
}

/// Starts a mode; `None` if it is not playable.
pub fn start(
    mode: Mode,
    player_setup: &PlayerSetup,
) -> Option<Result<Box<dyn Player>, DriveError>> {
    let playable = PLAYABLE.iter().find(|playable| playable.mode == mode)?;
    Some(playable.player_factory.start(player_setup, mode))
}

/// One mode of a scene, run frame by frame.
pub trait Player {
    /// Sends the commands before the first step and waits until they are applied.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError>;

    /// One frame of a simulator: commands, steps, and every pose the frame shows.
    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError>;

    /// Waits for all requested steps, then returns the state of the scene.
    fn totals(&mut self) -> Result<PlayerTotals, DriveError>;
}

/// Cost of a frame for the caller's thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCost {
    /// Wall-clock time, nanoseconds.
    pub wall_ns: u64,
    /// Processor time of the thread within it, where the system reports it; the rest is waiting.
    pub work_ns: Option<u64>,
}

/// State of a scene and its traffic since the start, without joining.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlayerTotals {
    /// Tick of the scene.
    pub tick: Tick,
    /// Digest of all observations of the scene.
    pub truth: u64,
    /// Bodies that are awake.
    pub awake: u32,
    /// Time of the stepping process, by stage.
    pub stages: Stages,
    /// Traffic since joining.
    pub traffic: Traffic,
    /// Client of the paper's protocol: frames whose end message was lost.
    pub ends_lost: u64,
}

/// Time per stage of the stepping process, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stages {
    /// The engine's steps.
    pub step_ns: u64,
    /// Reading the engine's states.
    pub observe_ns: u64,
    /// Choosing, encoding and handing over.
    pub publish_ns: u64,
}

/// Traffic on the wire; bytes include each datagram's headers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes from server to client.
    pub bytes_down: u64,
    /// Bytes from client to server.
    pub bytes_up: u64,
    /// UDP datagrams from server to client.
    pub datagrams_down: u64,
    /// UDP datagrams from client to server.
    pub datagrams_up: u64,
    /// Updates that the client applied.
    pub updates: u64,
}

impl Stages {
    fn of(times: &StageTimes) -> Self {
        Self {
            step_ns: times.step_total,
            observe_ns: times.observe_total,
            publish_ns: times.publish_total,
        }
    }
}

impl PlayerTotals {
    /// Reports of the server, and the traffic that the client has counted.
    fn of(inspection: &Inspection, traffic: Traffic) -> Self {
        Self {
            tick: inspection.tick,
            truth: inspection.truth,
            awake: inspection.awake,
            stages: Stages::of(&inspection.times),
            traffic,
            ends_lost: 0,
        }
    }
}

impl FrameCost {
    /// Runs a frame of a remote player and adds its traffic.
    fn of(
        run: impl FnOnce() -> Result<Frame, DriveError>,
        traffic: &mut Traffic,
    ) -> Result<Self, DriveError> {
        let work = work_ns();
        let frame = run()?;
        let work_ns = work_ns().zip(work).map(|(after, before)| after - before);
        traffic.add(&frame);
        Ok(Self {
            wall_ns: frame.frame_ns,
            work_ns,
        })
    }
}

impl Traffic {
    fn add(&mut self, frame: &Frame) {
        let headers = |datagrams| datagrams * DATAGRAM_HEADER_BYTES;
        self.bytes_down += frame.wire_bytes_down + headers(frame.wire_datagrams_down);
        self.bytes_up += frame.wire_bytes_up + headers(frame.wire_datagrams_up);
        self.datagrams_down += frame.wire_datagrams_down;
        self.datagrams_up += frame.wire_datagrams_up;
        self.updates += frame.updates;
    }
}

/// Settings common to all players of one scene.
#[derive(Clone, Debug)]
pub struct PlayerSetup {
    /// Config of the scene.
    pub config: SceneConfig,
    /// Number of bodies placed in total, late ones included.
    pub bodies: u32,
    /// Tolerance of the predicted streams.
    pub tolerance: Tolerance,
    /// Defects of the clients of the paper's protocol.
    pub defects: Defects,
    /// Cores and threads of the servers.
    pub cpu: ServerCpu,
    /// Seed of the script.
    pub seed: u64,
}

/// Starts players of one or more modes.
trait PlayerFactory {
    /// Starts a player of a mode.
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError>;
}

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
struct InThread;

impl PlayerFactory for InThread {
    fn start(&self, player_setup: &PlayerSetup, _: Mode) -> Result<Box<dyn Player>, DriveError> {
        let threads = player_setup.cpu.threads;
        let workers = StepThreads::new(threads).map_err(DriveError::StepThreads)?;
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

/// A client of a server that steps for it alone.
struct RemotePlayer {
    remote: Remote,
    traffic: Traffic,
}

/// Factory of players that use the Rhumb protocol.
struct OverRhumb;

impl PlayerFactory for OverRhumb {
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let depth = if mode.is_ahead() {
            PipelineDepth::PIPELINED
        } else {
            PipelineDepth::LOCKSTEP
        };
        let stream = match mode {
            Mode::Naive => StreamChoice::Full,
            _ => StreamChoice::Within(player_setup.tolerance),
        };
        begin(player_setup, stream, depth)
    }
}

/// Player of the predicted stream at any pipeline depth.
pub fn remote_player_at(
    player_setup: &PlayerSetup,
    depth: PipelineDepth,
) -> Result<Box<dyn Player>, DriveError> {
    begin(
        player_setup,
        StreamChoice::Within(player_setup.tolerance),
        depth,
    )
}

fn begin(
    player_setup: &PlayerSetup,
    stream: StreamChoice,
    depth: PipelineDepth,
) -> Result<Box<dyn Player>, DriveError> {
    let remote = Remote::start(&Setup {
        stream,
        depth,
        delay: Ticks::ZERO,
        config: player_setup.config,
        controller_script: None,
        cpu: player_setup.cpu.clone(),
        link: &LinkConfig::PERFECT,
        seed: player_setup.seed,
        bodies: player_setup.bodies,
        keep: Retention::Costs,
    })?;
    Ok(Box::new(RemotePlayer {
        remote,
        traffic: Traffic::default(),
    }))
}

impl Player for RemotePlayer {
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.remote.prepare(commands)
    }

    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError> {
        let run = || {
            self.remote.frame(commands)?;
            Ok(self.remote.take_frame().unwrap_or_default())
        };
        FrameCost::of(run, &mut self.traffic)
    }

    fn totals(&mut self) -> Result<PlayerTotals, DriveError> {
        self.remote.client().wait(PipelineDepth::LOCKSTEP)?;
        Ok(PlayerTotals::of(&self.remote.inspect()?, self.traffic))
    }
}

/// A client that leads a scene on a server of its own.
struct AppPlayer {
    remote: AppRemote,
    traffic: Traffic,
}

/// Factory of players that use the paper's protocol.
struct OverApp;

impl PlayerFactory for OverApp {
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError> {
        let remote = AppRemote::start(&AppSetup {
            mode,
            defects: player_setup.defects,
            config: player_setup.config,
            controller_script: None,
            cpu: player_setup.cpu.clone(),
            keep: Retention::Costs,
        })?;
        Ok(Box::new(AppPlayer {
            remote,
            traffic: Traffic::default(),
        }))
    }
}

impl Player for AppPlayer {
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError> {
        self.remote.prepare(commands)
    }

    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError> {
        let run = || {
            self.remote.frame(commands)?;
            Ok(self.remote.take_frame().unwrap_or_default())
        };
        FrameCost::of(run, &mut self.traffic)
    }

    fn totals(&mut self) -> Result<PlayerTotals, DriveError> {
        let (traffic, ends_lost) = (self.traffic, self.remote.ends_lost());
        // The scene starts with its first frame.
        if self.remote.ticks() == 0 {
            return Ok(PlayerTotals {
                traffic,
                ..PlayerTotals::default()
            });
        }
        Ok(PlayerTotals {
            ends_lost,
            ..PlayerTotals::of(&self.remote.inspect()?, traffic)
        })
    }
}
