//! Modes that step in turn, of which only what they cost is kept.
//!
//! A frame is as many steps as lie between two ticks that the scene's streams speak of. Who plays keeps nothing of a
//! frame but its cost: neither poses nor bytes, so that a run of hours is no larger than one of seconds.

mod app_player;
mod local;
mod processor;
mod remote_player;

use rhumb_protocol::message::StageTimes;
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{Tick, Tolerance};

use super::{Defects, DriveError, ServerCpu};
use crate::record::{Frame, Mode};
use crate::summary::DATAGRAM_HEADER_BYTES;

pub(crate) use remote_player::remote_player_at;

/// One mode of a scene, frame by frame.
pub(crate) trait Player {
    /// Gives the commands before the first step, and waits until they are done.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError>;

    /// One frame of a simulator: commands, steps, and every pose that the frame shows.
    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError>;

    /// Waits for all steps that were asked for, and says how the scene stands.
    fn totals(&mut self) -> Result<PlayerTotals, DriveError>;
}

/// What a frame took the caller's thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FrameCost {
    /// By the clock, nanoseconds.
    pub(crate) wall_ns: u64,
    /// Of these the thread's own work, where the system tells; the rest was waiting.
    pub(crate) work_ns: Option<u64>,
}

/// How a scene stands, and what came and went since it began; joining is left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PlayerTotals {
    pub(crate) tick: Tick,
    /// Digest of everything that was ever observed in it.
    pub(crate) truth: u64,
    pub(crate) awake: u32,
    pub(crate) stages: Stages,
    pub(crate) traffic: Traffic,
    /// Of a client of the paper's protocol: frames whose end it did not hear.
    pub(crate) ends_lost: u64,
}

/// Where the time of whoever steps went, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Stages {
    pub(crate) step_ns: u64,
    pub(crate) observe_ns: u64,
    pub(crate) publish_ns: u64,
}

/// What crossed the wire; bytes have each datagram's headers counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Traffic {
    pub(crate) bytes_down: u64,
    pub(crate) bytes_up: u64,
    pub(crate) datagrams_down: u64,
    pub(crate) datagrams_up: u64,
    pub(crate) updates: u64,
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

/// What every player of one scene is asked for alike.
#[derive(Clone, Debug)]
pub(crate) struct PlayerSetup {
    pub(crate) config: SceneConfig,
    /// Bodies that are placed in all, the last ones included.
    pub(crate) bodies: u32,
    /// What reckoned modes promise.
    pub(crate) tolerance: Tolerance,
    /// What clients of the paper's protocol lose.
    pub(crate) defects: Defects,
    /// Where servers run.
    pub(crate) cpu: ServerCpu,
    pub(crate) seed: u64,
}

/// Who plays one or several modes.
trait PlayerFactory {
    /// Sets up all that a mode needs.
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError>;
}

/// A mode that can be played, and by whom.
pub(crate) struct Playable {
    pub(crate) mode: Mode,
    player_factory: &'static (dyn PlayerFactory + Sync),
}

/// All modes that can be played, in the order of reports. A mode joins by a line.
const PLAYABLE: &[Playable] = &[
    Playable {
        mode: Mode::Integrated,
        player_factory: &local::InThread,
    },
    Playable {
        mode: Mode::AppAll,
        player_factory: &app_player::OverApp,
    },
    Playable {
        mode: Mode::AppActive,
        player_factory: &app_player::OverApp,
    },
    Playable {
        mode: Mode::AppPacked,
        player_factory: &app_player::OverApp,
    },
    Playable {
        mode: Mode::Naive,
        player_factory: &remote_player::OverRhumb,
    },
    Playable {
        mode: Mode::Rhumb,
        player_factory: &remote_player::OverRhumb,
    },
    Playable {
        mode: Mode::RhumbPipelined,
        player_factory: &remote_player::OverRhumb,
    },
];

/// The modes that can be played, in the order of reports.
pub(crate) fn playable() -> impl Iterator<Item = Mode> {
    PLAYABLE.iter().map(|playable| playable.mode)
}

/// Starts a mode; `None` if it cannot be played.
pub(crate) fn start(
    mode: Mode,
    player_setup: &PlayerSetup,
) -> Option<Result<Box<dyn Player>, DriveError>> {
    let playable = PLAYABLE.iter().find(|playable| playable.mode == mode)?;
    Some(playable.player_factory.start(player_setup, mode))
}
