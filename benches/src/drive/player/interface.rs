//! A mode that is stepped frame by frame, and what a frame of it costs.

use rhumb_protocol::message::StageTimes;
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{Tick, Tolerance};

use crate::drive::app::Defects;
use crate::drive::error::DriveError;
use crate::drive::process::ServerCpu;
use crate::record::{Frame, Mode};
use crate::summary::DATAGRAM_HEADER_BYTES;

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
    pub(super) fn of(times: &StageTimes) -> Self {
        Self {
            step_ns: times.step_total,
            observe_ns: times.observe_total,
            publish_ns: times.publish_total,
        }
    }
}

impl Traffic {
    pub(super) fn add(&mut self, frame: &Frame) {
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
pub(super) trait PlayerFactory {
    /// Starts a player of a mode.
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError>;
}
