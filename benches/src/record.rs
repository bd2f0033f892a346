//! What a run leaves behind: all figures of a report come from this.
//!
//! No clocks and no files: measured by `drive`, written by `trace`, summed up by `summary`, drawn by `report`.

use std::fmt;

use bytes::Bytes;
use rhumb_protocol::Span;
use rhumb_protocol::scene::{BodyDesc, Shape};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Tick};
use serde::{Deserialize, Serialize};

/// How a scene was run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mode {
    /// Stepped in the caller's own thread.
    Integrated,
    /// A server that sends everything.
    Naive,
    /// The reckoned stream; the caller waits for each tick.
    Rhumb,
    /// The reckoned stream; the caller goes on while the server steps.
    RhumbPipelined,
    /// The reckoned stream; the server steps by its own clock.
    RhumbFree,
    /// The full stream of the same server that runs by its own clock.
    NaiveFree,
    /// The paper's protocol: every body's state in a datagram of its own.
    AppAll,
    /// The same of bodies that are awake.
    AppActive,
    /// Every body's state, as many in a datagram as fit.
    AppPacked,
    /// The reckoned stream of a recorded scene, over a simulated link in simulated time.
    Replay,
}

impl Mode {
    /// Whether the caller goes on while the server steps.
    #[must_use]
    pub const fn is_ahead(self) -> bool {
        matches!(self, Self::RhumbPipelined)
    }

    /// Whether the server steps by its own clock.
    #[must_use]
    pub const fn is_free(self) -> bool {
        matches!(self, Self::RhumbFree | Self::NaiveFree)
    }

    /// Whether it speaks the paper's protocol.
    #[must_use]
    pub const fn is_app(self) -> bool {
        matches!(self, Self::AppAll | Self::AppActive | Self::AppPacked)
    }

    /// As on the command line, in topics and in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Integrated => "integrated",
            Self::Naive => "naive",
            Self::Rhumb => "rhumb",
            Self::RhumbPipelined => "rhumb-pipelined",
            Self::RhumbFree => "rhumb-free",
            Self::NaiveFree => "naive-free",
            Self::AppAll => "app-all",
            Self::AppActive => "app-active",
            Self::AppPacked => "app-packed",
            Self::Replay => "replay",
        }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What the engine did in one run of a script, tick by tick: the same for every mode.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Every body that ever was, in order of placing, with the tick at which it came.
    pub placed: Vec<Placed>,
    /// Bodies removed, with the tick at which they went.
    pub removed: Vec<(Tick, BodyId)>,
    /// Observations after tick 1, 2, ...: only bodies that moved or fell asleep.
    pub ticks: Vec<Vec<Observation>>,
    /// Digest over all observations.
    pub digest: u64,
}

/// A body and where it began.
#[derive(Clone, Debug)]
pub struct Placed {
    /// Before the step that follows this tick.
    pub tick: Tick,
    /// What it is.
    pub desc: BodyDesc,
    /// Its shape.
    pub shape: Shape,
    /// Where it was placed.
    pub observation: Observation,
}

/// A pose that a client's copy took on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CopiedPose {
    /// Whose.
    pub id: BodyId,
    /// Metres.
    pub position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Whether the copy takes it for resting.
    pub resting: bool,
}

/// Why a copy was farther off than its tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// A datagram was lost and not yet made good.
    Loss,
    /// The view shows a tick that the stream has not watermark_tick for yet, or that lies before what it was last told.
    Late,
    /// The stream's budget did not suffice, and it said so.
    Budget,
    /// Nothing explains it: a defect.
    Fault,
}

impl Cause {
    /// All of them, in the order of a report.
    pub const ALL: [Self; 4] = [Self::Loss, Self::Late, Self::Budget, Self::Fault];

    /// As in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Loss => "loss",
            Self::Late => "late",
            Self::Budget => "budget",
            Self::Fault => "fault",
        }
    }
}

/// One body-tick over tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breach {
    /// When.
    pub tick: Tick,
    /// Which.
    pub id: BodyId,
    /// Surface error, metres.
    pub error_m: f64,
    /// What was promised, metres.
    pub tolerance_m: f64,
    /// Why.
    pub cause: Cause,
}

/// Which way a datagram or a piece of control stream went, as the client saw it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum PacketDirection {
    /// State datagram from the server.
    StateDown,
    /// State datagram to the server.
    StateUp,
    /// Bytes of the control stream from the server.
    ControlDown,
    /// Bytes of the control stream to the server.
    ControlUp,
}

/// Something that crossed the wire.
#[derive(Clone, Debug)]
pub struct CapturedPacket {
    /// The frame (counted from 0) in which the client saw it pass.
    pub frame: u32,
    /// Which way.
    pub direction: PacketDirection,
    /// What, below QUIC.
    pub bytes: Bytes,
    /// For how many bytes it counts: for its own, unless what another code would take is counted.
    pub counted: u64,
}

impl CapturedPacket {
    /// What counts for what it is.
    #[must_use]
    pub fn new(frame: u32, direction: PacketDirection, bytes: Bytes) -> Self {
        let counted = bytes.len() as u64;
        Self {
            frame,
            direction,
            bytes,
            counted,
        }
    }
}

/// One frame of the caller.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// The tick that its view showed; errors are taken against the truth of this tick.
    pub tick: Tick,
    /// What the frame cost the caller's thread, nanoseconds.
    pub frame_ns: u64,
    /// UDP payload bytes received and sent since the frame before, QUIC's own included.
    pub wire_bytes_down: u64,
    /// See above.
    pub wire_bytes_up: u64,
    /// UDP datagrams received and sent since the frame before.
    pub wire_datagrams_down: u64,
    /// See above.
    pub wire_datagrams_up: u64,
    /// Updates taken in since the frame before.
    pub updates: u64,
    /// Poses that changed in the copy since the frame before.
    pub seen: Vec<CopiedPose>,
    /// Bodies taken out of the copy since the frame before.
    pub gone: Vec<BodyId>,
    /// Surface error of every body that is neither static nor at rest to the bit in both truth and copy, metres, sorted.
    pub errors_m: Vec<f32>,
    /// Bodies (of those that can move) whose error is exactly zero and not listed above.
    pub exact: u32,
    /// Of a replay: surface error of every body that the recording has a record of at this tick, metres, in no order.
    pub moving_errors_m: Vec<f32>,
}

/// How a run was asked for.
#[derive(Clone, Debug)]
pub struct RunConfig {
    /// Name of the script.
    pub scene: String,
    /// What its load was asked to be.
    pub bodies: u32,
    /// How it was run.
    pub mode: Mode,
    /// Frames that the caller is ahead of the server.
    pub depth: u32,
    /// Promised, metres; none for modes that promise the bits.
    pub tolerance_m: Option<f64>,
    /// Bytes a second that its stream could take, if that was limited.
    pub budget_bytes_per_second: Option<u32>,
    /// The link between the processes, as on the command line.
    pub link: String,
    /// Seed of the script; of the link where a foreign recording was replayed.
    pub seed: u64,
    /// Simulated seconds of one tick.
    pub step_s: f64,
    /// How many ticks were run.
    pub ticks: u32,
    /// Of a free-running mode: how it was published and followed.
    pub subscription: Option<SubscriptionSettings>,
    /// Of a replay: what only a replay is asked for.
    pub replayed: Option<Replayed>,
    /// What was found to do for the same promise, had the future been known; none if that was not sought.
    pub limit: Option<LimitRates>,
}

/// How a free-running scene was published and followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SubscriptionSettings {
    /// Published every so many ticks.
    pub publish_interval: u32,
    /// Ticks that the publisher looked back before it spoke of one.
    pub lookahead_ticks: u32,
    /// Ticks that the copy was shown later than it could be spoken of.
    pub delay_ticks: u32,
}

/// What only a replay is asked for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// How far a body's centre may be off, metres, where its turn has a bound of its own.
    pub position_m: Option<f64>,
    /// How far it may be turned then, radians.
    pub turn_rad: Option<f64>,
    /// Published every so many ticks.
    pub publish_interval: u32,
    /// Ticks that the publisher looked back before it spoke of one.
    pub lookahead_ticks: u32,
    /// Seed of the simulated link.
    pub link_seed: u64,
    /// Means of the publisher that were switched off, as on the command line.
    pub without: Vec<String>,
}

/// How little was found to do.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitRates {
    /// Updates for each simulated second.
    pub updates_per_second: f64,
    /// The same where motions are rounded to the protocol's grid.
    pub updates_on_grid_per_second: f64,
    /// 1,000 bit/s of simulated time.
    pub kbps: f64,
}

/// One mode's run of one scene at one load.
#[derive(Clone, Debug)]
pub struct Run {
    /// How it was asked for.
    pub config: RunConfig,
    /// Digest of the truth as its own engine had it.
    pub truth_checksum: u64,
    /// Frame by frame, the joining (frame 0's predecessors) left out.
    pub frames: Vec<Frame>,
    /// Everything that crossed the wire; empty for `integrated`.
    pub captured: Vec<CapturedPacket>,
    /// UDP payload bytes and datagrams, both ways, of connecting and joining, before the first frame.
    pub join: JoinCost,
    /// Every body-tick over tolerance.
    pub breaches: Vec<Breach>,
    /// Of a replay: how long after each lost packet all of its bodies were known again.
    pub recoveries: Vec<Span>,
    /// Median and 99th percentile of the engine's step, nanoseconds.
    pub step_ns_p50: u64,
    /// See above.
    pub step_ns_p99: u64,
    /// All engine steps together, nanoseconds.
    pub step_ns_total: u64,
    /// Observing, choosing, encoding and handing over, all ticks together, nanoseconds; zero for `integrated`.
    pub publish_ns_total: u64,
    /// Sums over tracks in which the two ends were found to differ: a defect.
    pub mismatches: u64,
}

/// What it cost to come in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JoinCost {
    /// UDP payload bytes received.
    pub wire_bytes_down: u64,
    /// UDP datagrams received.
    pub wire_datagrams_down: u64,
    /// UDP payload bytes sent.
    pub wire_bytes_up: u64,
    /// UDP datagrams sent.
    pub wire_datagrams_up: u64,
}

/// Everything that one invocation measured: one truth per load, and the modes run on it.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// The command line, as typed.
    pub command: String,
    /// Seed of the scripts.
    pub seed: u64,
    /// Processor, cores, system.
    pub machine: String,
    /// Per load.
    pub loads: Vec<Load>,
}

/// One load of one scene.
#[derive(Clone, Debug)]
pub struct Load {
    /// What the engine did.
    pub truth: Truth,
    /// What each mode made of it.
    pub runs: Vec<Run>,
    /// Replays of it that did not come to their end.
    pub unfinished: Vec<Unfinished>,
}

/// A replay that did not come to its end: nothing else is kept of it.
#[derive(Clone, Debug)]
pub struct Unfinished {
    /// How it was asked for.
    pub config: RunConfig,
    /// Why, in words.
    pub cause: String,
}
