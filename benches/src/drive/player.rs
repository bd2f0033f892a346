//! Modes that step in turn and record only their cost.
//!
//! A frame covers the steps between two published ticks. A player keeps only the cost of a frame, neither poses nor
//! packets, so memory does not grow with the length of a run.

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

/// One mode of a scene, run frame by frame.
pub(crate) trait Player {
    /// Sends the commands before the first step and waits until they are applied.
    fn prepare(&mut self, commands: &[Command]) -> Result<(), DriveError>;

    /// One frame of a simulator: commands, steps, and every pose the frame shows.
    fn frame(&mut self, commands: &[Command]) -> Result<FrameCost, DriveError>;

    /// Waits for all requested steps, then returns the state of the scene.
    fn totals(&mut self) -> Result<PlayerTotals, DriveError>;
}

/// Cost of a frame for the caller's thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FrameCost {
    /// Wall-clock time, nanoseconds.
    pub(crate) wall_ns: u64,
    /// Processor time of the thread within it, where the system reports it; the rest is waiting.
    pub(crate) work_ns: Option<u64>,
}

/// State of a scene and its traffic since the start, without joining.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct PlayerTotals {
    pub(crate) tick: Tick,
    /// Digest of all observations of the scene.
    pub(crate) truth: u64,
    pub(crate) awake: u32,
    pub(crate) stages: Stages,
    pub(crate) traffic: Traffic,
    /// Client of the paper's protocol: frames whose end message was lost.
    pub(crate) ends_lost: u64,
}

/// Time per stage of the stepping process, nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Stages {
    pub(crate) step_ns: u64,
    pub(crate) observe_ns: u64,
    pub(crate) publish_ns: u64,
}

/// Traffic on the wire; bytes include each datagram's headers.
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

/// Settings common to all players of one scene.
#[derive(Clone, Debug)]
pub(crate) struct PlayerSetup {
    pub(crate) config: SceneConfig,
    /// Number of bodies placed in total, late ones included.
    pub(crate) bodies: u32,
    /// Tolerance of the predicted streams.
    pub(crate) tolerance: Tolerance,
    /// Defects of the clients of the paper's protocol.
    pub(crate) defects: Defects,
    /// Cores and threads of the servers.
    pub(crate) cpu: ServerCpu,
    pub(crate) seed: u64,
}

/// Starts players of one or more modes.
trait PlayerFactory {
    /// Starts a player of a mode.
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError>;
}

/// A playable mode and its factory.
pub(crate) struct Playable {
    pub(crate) mode: Mode,
    player_factory: &'static (dyn PlayerFactory + Sync),
}

/// All playable modes in the order of reports; adding a mode takes one entry.
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

/// The playable modes, in the order of reports.
pub(crate) fn playable() -> impl Iterator<Item = Mode> {
    PLAYABLE.iter().map(|playable| playable.mode)
}

/// Starts a mode; `None` if it is not playable.
pub(crate) fn start(
    mode: Mode,
    player_setup: &PlayerSetup,
) -> Option<Result<Box<dyn Player>, DriveError>> {
    let playable = PLAYABLE.iter().find(|playable| playable.mode == mode)?;
    Some(playable.player_factory.start(player_setup, mode))
}
