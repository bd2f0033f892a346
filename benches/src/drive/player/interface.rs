//! A mode that is stepped frame by frame, and what a frame of it costs.

use rhumb_protocol::message::{Inspection, StageTimes};
use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::{Tick, Tolerance};

use crate::drive::app::Defects;
use crate::drive::error::DriveError;
use crate::drive::process::ServerCpu;
use crate::processor::work_ns;
use crate::record::{Frame, Mode};
use crate::summary::DATAGRAM_HEADER_BYTES;

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
    pub(super) fn of(inspection: &Inspection, traffic: Traffic) -> Self {
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
    pub(super) fn of(
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
pub(super) trait PlayerFactory {
    /// Starts a player of a mode.
    fn start(&self, player_setup: &PlayerSetup, mode: Mode) -> Result<Box<dyn Player>, DriveError>;
}
