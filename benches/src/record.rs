//! The record of a run, from which all figures of a report are computed.
//!
//! Contains no clocks and no files: measured by `drive`, written by `trace`, summarised by `summary`, drawn by
//! `report`.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::iter::Peekable;

use bytes::Bytes;
use clap::ValueEnum;
use rhumb_protocol::Span;
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Tick};
pub use rhumb_trace::Placed;
use rhumb_trace::SceneFacts;
use serde::{Deserialize, Serialize};

/// The way of running a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Mode {
    /// Stepped in the caller's own thread.
    Integrated,
    /// A server that sends every state (naive replication).
    Naive,
    /// The predicted stream; the caller waits for each tick.
    Rhumb,
    /// The predicted stream; the caller continues while the server steps.
    RhumbPipelined,
    /// The predicted stream; the server steps by its own clock.
    RhumbFree,
    /// The full stream of the free-running server.
    NaiveFree,
    /// The paper's protocol: one datagram per body state.
    AppAll,
    /// The paper's protocol, awake bodies only.
    AppActive,
    /// The paper's protocol, with as many states per datagram as fit.
    AppPacked,
    /// The predicted stream of a recorded scene, over a simulated link in simulated time.
    #[value(skip)]
    Replay,
}

impl Mode {
    /// True if the caller continues while the server steps.
    #[must_use]
    pub const fn is_ahead(self) -> bool {
        matches!(self, Self::RhumbPipelined)
    }

    /// True if the server steps by its own clock.
    #[must_use]
    pub const fn is_free(self) -> bool {
        matches!(self, Self::RhumbFree | Self::NaiveFree)
    }

    /// True if it uses the paper's protocol.
    #[must_use]
    pub const fn is_app(self) -> bool {
        matches!(self, Self::AppAll | Self::AppActive | Self::AppPacked)
    }

    /// Name on the command line, in topics and in the summary.
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

/// States of the engine in one run of a script, tick by tick; equal for every mode.
#[derive(Clone, Debug, Default)]
pub struct Truth {
    /// Every body ever placed, in order of placing, with its tick.
    pub placed: Vec<Placed>,
    /// Bodies removed, with their ticks.
    pub removed: Vec<(Tick, BodyId)>,
    /// Observations after tick 1, 2, ...: only bodies that moved or fell asleep.
    pub ticks: Vec<Vec<Observation>>,
    /// Digest over all observations.
    pub digest: u64,
}

/// A body comes or goes.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Change<'a> {
    /// A body, with its number among all placed ones.
    Placed(usize, &'a Placed),
    /// The body goes.
    Removed(BodyId),
}

/// Placements and removals in their order.
#[derive(Clone, Debug)]
pub(crate) struct Changes<'a>(Peekable<std::vec::IntoIter<(Tick, Change<'a>)>>);

impl<'a> Changes<'a> {
    /// The next change, if it is one of this tick or of an earlier one.
    pub(crate) fn until(&mut self, tick: Tick) -> Option<Change<'a>> {
        let due = self.0.next_if(|(when, _)| *when <= tick);
        due.map(|(_, change)| change)
    }

    /// The next change, if it is a placement at the first tick.
    pub(crate) fn first(&mut self) -> Option<&'a Placed> {
        let is_first = |(when, change): &(Tick, Change<'a>)| {
            *when == Tick::ZERO && matches!(change, Change::Placed(..))
        };
        match self.0.next_if(is_first)?.1 {
            Change::Placed(_, placed) => Some(placed),
            Change::Removed(_) => None,
        }
    }
}

impl Truth {
    /// All placements and removals. At one tick those go that were there, then others come, and then those go that came in it.
    pub(crate) fn changes(&self) -> Changes<'_> {
        let mut all = Vec::with_capacity(self.placed.len() + self.removed.len());
        let mut there = BTreeSet::new();
        let (mut placed, mut removed) = (self.placed.iter().enumerate(), &self.removed[..]);
        let mut coming = placed.next();
        loop {
            let next = coming.map(|(_, one)| one.tick);
            let Some(tick) = next
                .into_iter()
                .chain(removed.first().map(|(tick, _)| *tick))
                .min()
            else {
                return Changes(all.into_iter().peekable());
            };
            let (going, later) =
                removed.split_at(removed.partition_point(|(when, _)| *when <= tick));
            removed = later;
            let (before, new): (Vec<BodyId>, Vec<BodyId>) = going
                .iter()
                .map(|(_, id)| *id)
                .partition(|id| there.remove(id));
            let gone = |id| (tick, Change::Removed(id));
            all.extend(before.into_iter().map(gone));
            while let Some((number, one)) = coming.filter(|(_, one)| one.tick <= tick) {
                there.insert(one.desc.id);
                all.push((tick, Change::Placed(number, one)));
                coming = placed.next();
            }
            new.iter().for_each(|id| {
                there.remove(id);
            });
            all.extend(new.into_iter().map(gone));
        }
    }

    /// The tick after which each placed body is gone, in order of placing.
    pub(crate) fn ends(&self) -> Vec<Option<Tick>> {
        let mut ends = vec![None; self.placed.len()];
        let mut there = BTreeMap::new();
        let Changes(changes) = self.changes();
        for (tick, change) in changes {
            match change {
                Change::Placed(number, one) => {
                    there.insert(one.desc.id, number);
                }
                Change::Removed(id) => {
                    if let Some(number) = there.remove(&id) {
                        ends[number] = Some(tick);
                    }
                }
            }
        }
        ends
    }
}

/// A pose that changed in a client's copy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CopiedPose {
    /// The body.
    pub id: BodyId,
    /// Centre of mass, world frame, metres.
    pub position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// True if the copy counts the body as resting.
    pub resting: bool,
}

/// The cause of an excess over the tolerance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Cause {
    /// A datagram was lost and not yet recovered.
    Loss,
    /// The shown tick is past the stream's watermark or before the body's latest update.
    Late,
    /// The stream's budget did not suffice, as the stream stated.
    Budget,
    /// Unexplained: a defect.
    Fault,
}

impl Cause {
    /// All causes, in the order of a report.
    pub const ALL: [Self; 4] = [Self::Loss, Self::Late, Self::Budget, Self::Fault];

    /// Name in the summary.
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
    /// Tick of the breach.
    pub tick: Tick,
    /// The body.
    pub id: BodyId,
    /// Surface error, metres.
    pub error_m: f64,
    /// Its tolerance, metres.
    pub tolerance_m: f64,
    /// Cause of the breach.
    pub cause: Cause,
}

/// Direction and kind of a packet, as the client sees it.
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

/// Captured bytes of the wire.
#[derive(Clone, Debug)]
pub struct CapturedPacket {
    /// Frame, counted from 0, during which it passed the client.
    pub frame: u32,
    /// Direction and kind.
    pub direction: PacketDirection,
    /// The bytes as passed to or from QUIC.
    pub bytes: Bytes,
    /// Bytes counted for it: its length, unless another code's size is counted instead.
    pub counted: u64,
}

impl CapturedPacket {
    /// A packet counted by its own length.
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
    /// Tick that the view showed; errors refer to the truth of this tick.
    pub tick: Tick,
    /// Time that the frame took in the caller's thread, nanoseconds.
    pub frame_ns: u64,
    /// UDP payload bytes received since the previous frame, those of QUIC included.
    pub wire_bytes_down: u64,
    /// UDP payload bytes sent since the previous frame.
    pub wire_bytes_up: u64,
    /// UDP datagrams received since the previous frame.
    pub wire_datagrams_down: u64,
    /// UDP datagrams sent since the previous frame.
    pub wire_datagrams_up: u64,
    /// Updates decoded since the previous frame.
    pub updates: u64,
    /// Poses that changed in the copy since the previous frame.
    pub changed: Vec<CopiedPose>,
    /// Bodies removed from the copy since the previous frame.
    pub removed: Vec<BodyId>,
    /// Surface errors of all bodies except static ones and those at rest in both with equal bits. Metres, sorted.
    pub errors_m: Vec<f32>,
    /// Non-static bodies with an error of exactly zero that `errors_m` does not list.
    pub exact: u32,
    /// Replay only: surface error of every body that the recording lists at this tick, metres, unordered.
    pub moving_errors_m: Vec<f32>,
}

/// Requested settings of a run.
#[derive(Clone, Debug)]
pub struct RunConfig {
    /// Name of the script.
    pub scene: String,
    /// Requested number of bodies.
    pub bodies: u32,
    /// Mode of the run.
    pub mode: Mode,
    /// Frames by which the caller is ahead of the server.
    pub depth: u32,
    /// Tolerance, metres; none for bit-exact modes.
    pub tolerance_m: Option<f64>,
    /// Bandwidth limit of the stream, bytes per second, if any.
    pub budget_bytes_per_second: Option<u32>,
    /// Link between the processes, as on the command line.
    pub link: String,
    /// Seed of the script; for a replayed foreign recording, seed of the link.
    pub seed: u64,
    /// Simulated seconds of one tick.
    pub step_s: f64,
    /// Number of ticks run.
    pub ticks: u32,
    /// Publish and subscribe settings of a free-running mode.
    pub subscription: Option<SubscriptionSettings>,
    /// Settings that only a replay has.
    pub replayed: Option<Replayed>,
    /// The computed limit for the same tolerance; none if it was not computed.
    pub limit: Option<LimitRates>,
}

/// Publish and subscribe settings of a free-running scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SubscriptionSettings {
    /// Ticks between publications.
    pub publish_interval: u32,
    /// Ticks by which the encoder looks ahead of the tick it codes.
    pub lookahead_ticks: u32,
    /// Ticks by which the view lags behind the newest tick that can be shown.
    pub delay_ticks: u32,
}

/// Settings that only a replay has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replayed {
    /// Position tolerance, metres, where the rotation has a bound of its own.
    pub position_m: Option<f64>,
    /// Rotation tolerance in that case, radians.
    pub turn_rad: Option<f64>,
    /// Ticks between publications.
    pub publish_interval: u32,
    /// Ticks by which the encoder looks ahead of the tick it codes.
    pub lookahead_ticks: u32,
    /// Seed of the simulated link.
    pub link_seed: u64,
    /// Publisher features that were switched off, as on the command line.
    pub without: Vec<String>,
}

/// Rates found sufficient when the future is known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitRates {
    /// Updates per simulated second.
    pub updates_per_second: f64,
    /// The same with motions rounded to the protocol's grid.
    pub updates_on_grid_per_second: f64,
    /// 1,000 bit/s of simulated time.
    pub kbps: f64,
}

/// One mode's run of one scene at one load.
#[derive(Clone, Debug)]
pub struct Run {
    /// Settings of the run.
    pub config: RunConfig,
    /// Digest of the truth as this run's engine computed it.
    pub truth_checksum: u64,
    /// Frames, without those of joining.
    pub frames: Vec<Frame>,
    /// All packets on the wire; empty for `integrated`.
    pub captured: Vec<CapturedPacket>,
    /// UDP payload bytes and datagrams, both directions, before the first frame.
    pub join: JoinCost,
    /// Every body-tick over tolerance.
    pub breaches: Vec<Breach>,
    /// Replay only: time from each lost packet until all of its bodies were known again.
    pub recoveries: Vec<Span>,
    /// Median of the engine's step, nanoseconds.
    pub step_ns_p50: u64,
    /// 99th percentile of the engine's step, nanoseconds.
    pub step_ns_p99: u64,
    /// Sum of all engine steps, nanoseconds.
    pub step_ns_total: u64,
    /// Sum over all ticks of observing, selecting, encoding and queueing, nanoseconds; zero for `integrated`.
    pub publish_ns_total: u64,
    /// Track checksums that differed between the two ends: a defect.
    pub mismatches: u64,
}

/// Traffic of connecting and joining.
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

/// All measurements of one invocation: one truth per load and the modes run on it.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// The command line; its paths have no folders.
    pub command: String,
    /// Seed of the scripts.
    pub seed: u64,
    /// Processor, cores, operating system.
    pub machine: String,
    /// One entry per load.
    pub loads: Vec<Load>,
}

/// One load of one scene.
#[derive(Clone, Debug)]
pub struct Load {
    /// States of the engine.
    pub truth: Truth,
    /// The engine's settings that predictions need.
    pub facts: SceneFacts,
    /// One run per mode.
    pub runs: Vec<Run>,
    /// Replays of it that failed.
    pub unfinished: Vec<Unfinished>,
}

/// A failed replay; it has no results.
#[derive(Clone, Debug)]
pub struct Unfinished {
    /// Its settings.
    pub config: RunConfig,
    /// Cause of the failure.
    pub cause: String,
}
