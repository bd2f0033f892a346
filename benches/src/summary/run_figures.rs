//! The figures of one run, computed from its frames.
//!
//! Sums and divisors are decided here; the meaning of each figure is documented at its field.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::numbers::{WithZeros, of_nanoseconds};
use crate::record::{
    Breach, CapturedPacket, Cause, Frame, LimitRates, Mode, PacketDirection, Replayed, Run,
    RunConfig, SubscriptionSettings,
};

/// Bytes that IPv4 and UDP add to each datagram.
pub const DATAGRAM_HEADER_BYTES: u64 = 28;

/// Frame rate of the paper's simulator: its SimFPS never exceeds it.
pub const SIM_FPS_MAX: f64 = 11.33;

/// Figures of one mode's run of one scene at one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFigures {
    /// Name of the script.
    pub scene: String,
    /// Requested number of bodies.
    pub bodies: u32,
    /// Mode: `integrated`, `naive`, `rhumb`, `rhumb-pipelined`, `rhumb-free`, `naive-free`, `replay`.
    pub mode: String,
    /// Frames by which the caller is ahead of the server.
    pub depth: u32,
    /// Tolerance of the surface error, metres; `null` for a bit-exact mode.
    pub tolerance_m: Option<f64>,
    /// Bandwidth limit of the stream, bytes per second; `null` without a budget.
    pub budget_bytes_per_second: Option<u32>,
    /// Simulated link between the processes; `null` without one.
    pub link: Option<String>,
    /// Number of ticks run.
    pub ticks: u32,
    /// Publish and subscribe settings of a free-running mode.
    pub subscription: Option<SubscriptionSettings>,
    /// Settings that only a replay has.
    pub replayed: Option<Replayed>,
    /// Digest of the engine's states: 16 hexadecimal digits, equal for every mode of a valid load.
    pub truth_hash: String,
    /// True if the engine diverged from the load's other runs; such a run must not be compared.
    pub void: bool,
    /// Bytes from server to client after joining: UDP payload and 28 B of headers per datagram.
    pub bytes_down: Option<u64>,
    /// The same from client to server.
    pub bytes_up: Option<u64>,
    /// State datagrams and control stream down, as passed to QUIC.
    pub payload_bytes_down: Option<u64>,
    /// UDP datagrams down.
    pub datagrams_down: Option<u64>,
    /// `payload_bytes_down` over the simulated time of the run, 1,000 bit/s.
    pub payload_kbps_down: Option<f64>,
    /// `bytes_down` over the simulated time of the run, 1,000 bit/s.
    pub mean_kbps_down: Option<f64>,
    /// `bytes_down` of the worst simulated second (the whole run if it is shorter), 1,000 bit/s.
    pub worst_second_kbps_down: Option<f64>,
    /// Bytes down in the first five simulated seconds, or in the whole run if it is shorter.
    pub first_seconds: Option<FirstSeconds>,
    /// Reduction against the naive run of the same load.
    pub less_than_naive: Option<LessThanNaive>,
    /// Updates that the client decoded.
    pub updates: Option<u64>,
    /// Bits of state datagrams down, as passed to QUIC, per update.
    pub bits_per_update: Option<f64>,
    /// Surface error of every non-static body at every frame, against the engine at the same tick.
    pub surface_error_m: Option<ErrorQuantiles>,
    /// Frames without a comparison: no body was present, or the truth of their tick is unknown.
    pub unjudged_frames: Option<u64>,
    /// Body-ticks over tolerance.
    pub over_tolerance: Option<OverTolerance>,
    /// Track checksums that differed between the two ends: a defect.
    pub mismatches: Option<u64>,
    /// Replay only: errors of bodies that the recording lists at the tick.
    pub moving: Option<Moving>,
    /// The computed limit for the same tolerance and a known future; `null` if it was not computed.
    pub limit: Option<LimitRates>,
    /// Updates and payload bits relative to the limit.
    pub of_limit: Option<OfLimit>,
    /// Replay only: recovery times of lost packets; `null` if none was lost.
    pub recovery: Option<Recovery>,
    /// Frame times of the caller's thread.
    pub frame_ms: Option<FrameTimes>,
    /// The paper's measure: one over the mean frame time, capped at [`SIM_FPS_MAX`].
    pub sim_fps: Option<f64>,
    /// Step times of the engine.
    pub step_ms: StepTimes,
    /// Time of observing, selecting, encoding and queueing, divided by the time of stepping.
    pub publish_share: Option<f64>,
    /// Traffic of joining, before the first frame.
    pub join: Option<Join>,
}

impl RunFigures {
    /// Updates decoded per simulated second.
    #[must_use]
    pub fn updates_per_second(&self) -> Option<f64> {
        let (bytes, kbps) = (self.bytes_down?, self.mean_kbps_down?);
        let simulated_s = bytes as f64 * 8.0 / 1e3 / kbps;
        Some(self.updates? as f64 / simulated_s)
    }

    /// The naive run to compare with; for a free-running scene, the one on the same server.
    #[must_use]
    pub fn baseline<'a>(&self, runs: &'a [Self]) -> Option<&'a Self> {
        let free = || self.beside(runs, "naive-free");
        let naive = || self.beside(runs, "naive");
        if self.mode.ends_with("-free") {
            free().or_else(naive)
        } else {
            naive()
        }
    }

    /// The run of another mode with otherwise equal settings.
    #[must_use]
    pub fn beside<'a>(&self, runs: &'a [Self], mode: &str) -> Option<&'a Self> {
        let same = |run: &&Self| run.scene == self.scene && run.bodies == self.bodies;
        let mut of_mode = runs.iter().filter(same).filter(|run| run.mode == mode);
        let first = of_mode.clone().next();
        of_mode.find(|run| run.link == self.link).or(first)
    }
}

/// Surface errors, metres: |Δp| + 2 r sin(Δθ/2), r the bounding radius; no point of a body is farther off.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ErrorQuantiles {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Worst.
    pub max: f64,
}

/// Body-ticks over tolerance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OverTolerance {
    /// Number of such body-ticks.
    pub count: u64,
    /// Share of all body-ticks of non-static bodies.
    pub share: f64,
    /// Number for each cause: `loss`, `late`, `budget`, and `fault`, which must be zero.
    pub by_cause: BTreeMap<String, u64>,
}

/// Errors of bodies that moved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moving {
    /// Body-ticks with a record; `over_tolerance_share` is relative to them.
    pub body_ticks: u64,
    /// Surface errors of these body-ticks.
    pub surface_error_m: ErrorQuantiles,
    /// Body-ticks of any body over tolerance, divided by `body_ticks`.
    pub over_tolerance_share: f64,
}

/// Traffic down at the start, where a scene is busiest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FirstSeconds {
    /// Length of the span, simulated seconds.
    pub seconds: f64,
    /// `payload_bytes_down` of the span.
    pub payload_bytes_down: u64,
    /// `bytes_down` of the span: with headers.
    pub bytes_down: u64,
}

/// Bytes down of the naive run divided by those of this run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LessThanNaive {
    /// Payload, whole run.
    pub payload: f64,
    /// Bytes with headers, whole run.
    pub with_headers: f64,
    /// Payload, first seconds.
    pub payload_first: f64,
    /// Bytes with headers, first seconds.
    pub with_headers_first: f64,
}

/// Factors over the computed limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OfLimit {
    /// Updates over the fewest.
    pub updates: f64,
    /// Updates over the fewest with motions on the protocol's grid.
    pub updates_on_grid: f64,
    /// Payload bits down over the fewest.
    pub bits: f64,
}

/// Time from sending a lost packet until all of its bodies are known again, at its tick or later.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// Ticks of which a packet was lost.
    pub losses: u64,
    /// Median, milliseconds.
    pub p50_ms: f64,
    /// 99th percentile, milliseconds.
    pub p99_ms: f64,
    /// The same in ticks.
    pub p99_ticks: f64,
}

/// Frame times, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Mean.
    pub mean: f64,
}

/// Step times, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepTimes {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// Traffic of joining: datagrams, and bytes with 28 B of headers for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Join {
    /// Server to client.
    pub bytes_down: u64,
    /// Server to client.
    pub datagrams_down: u64,
    /// Client to server.
    pub bytes_up: u64,
    /// Client to server.
    pub datagrams_up: u64,
}

const NANOSECONDS_PER_MILLISECOND: f64 = 1e6;

/// All figures of a run.
pub(super) fn figures_of_run(run: &Run, truth_checksum: u64) -> RunFigures {
    let config = &run.config;
    let mut errors = WithZeros::default();
    for frame in &run.frames {
        errors.extend(&frame.errors_m, frame.exact);
    }
    // No caller waits for the frames of a replay.
    let waited = config.mode != Mode::Replay;
    let frame_ms = waited.then(|| frame_times(&run.frames)).flatten();
    let mut figures = RunFigures {
        scene: config.scene.clone(),
        bodies: config.bodies,
        mode: config.mode.name().to_owned(),
        depth: config.depth,
        tolerance_m: config.tolerance_m,
        budget_bytes_per_second: config.budget_bytes_per_second,
        link: None,
        ticks: config.ticks,
        subscription: config.subscription,
        replayed: config.replayed.clone(),
        truth_hash: format!("{:016x}", run.truth_checksum),
        void: run.truth_checksum != truth_checksum,
        bytes_down: None,
        bytes_up: None,
        payload_bytes_down: None,
        datagrams_down: None,
        payload_kbps_down: None,
        mean_kbps_down: None,
        worst_second_kbps_down: None,
        first_seconds: None,
        less_than_naive: None,
        updates: None,
        bits_per_update: None,
        surface_error_m: None,
        unjudged_frames: None,
        over_tolerance: None,
        mismatches: None,
        moving: None,
        limit: config.limit,
        of_limit: None,
        recovery: None,
        frame_ms,
        sim_fps: frame_ms.map(|ms| (1e3 / ms.mean).min(SIM_FPS_MAX)),
        step_ms: StepTimes {
            p50: run.step_ns_p50 as f64 / NANOSECONDS_PER_MILLISECOND,
            p99: run.step_ns_p99 as f64 / NANOSECONDS_PER_MILLISECOND,
        },
        publish_share: None,
        join: None,
    };
    if config.mode != Mode::Integrated {
        add_wire(&mut figures, run);
        figures.first_seconds = first_seconds(run);
        figures.unjudged_frames = Some(unjudged(run));
        figures.surface_error_m = ErrorQuantiles::of(&mut errors);
        figures.over_tolerance = Some(over_tolerance(&run.breaches, errors.count()));
        figures.mismatches = Some(run.mismatches);
        figures.publish_share =
            (run.step_ns_total > 0).then(|| run.publish_ns_total as f64 / run.step_ns_total as f64);
    }
    if config.mode == Mode::Replay {
        figures.moving = moving(run);
        figures.recovery = recovery(run);
    }
    figures.of_limit = of_limit(&figures);
    figures
}

/// Length of the start span, simulated seconds.
const FIRST_S: f64 = 5.0;

/// Simulated seconds between two frames; a replay has one frame per published tick.
fn frame_s(run: &Run) -> f64 {
    let publish_interval = run
        .config
        .replayed
        .as_ref()
        .map_or(1, |config| config.publish_interval);
    run.config.step_s * f64::from(publish_interval)
}

/// Traffic down in the first frames.
fn first_seconds(run: &Run) -> Option<FirstSeconds> {
    let step_s = frame_s(run);
    let wanted = (FIRST_S / step_s).round() as usize;
    let frames = wanted.min(run.frames.len());
    let within = |captured: &&CapturedPacket| (captured.frame as usize) < frames;
    let down = |captured: &&CapturedPacket| {
        matches!(
            captured.direction,
            PacketDirection::StateDown | PacketDirection::ControlDown
        )
    };
    let payload = run.captured.iter().filter(within).filter(down);
    (frames > 0).then(|| FirstSeconds {
        seconds: frames as f64 * step_s,
        payload_bytes_down: payload.map(|captured| captured.counted).sum(),
        bytes_down: run.frames[..frames].iter().map(bytes_down).sum(),
    })
}

fn unjudged(run: &Run) -> u64 {
    let empty = |frame: &&Frame| frame.exact == 0 && frame.errors_m.is_empty();
    run.frames.iter().filter(empty).count() as u64
}

/// Fills in the reduction of each run against its naive run.
pub(super) fn compare_with_naive(runs: &mut [RunFigures]) {
    let ratio = |naive: u64, own: u64| (own > 0).then(|| naive as f64 / own as f64);
    let of = |run: &RunFigures| {
        let naive = run.baseline(runs).filter(|naive| naive.mode != run.mode)?;
        let (first, own_first) = (naive.first_seconds?, run.first_seconds?);
        Some(LessThanNaive {
            payload: ratio(naive.payload_bytes_down?, run.payload_bytes_down?)?,
            with_headers: ratio(naive.bytes_down?, run.bytes_down?)?,
            payload_first: ratio(first.payload_bytes_down, own_first.payload_bytes_down)?,
            with_headers_first: ratio(first.bytes_down, own_first.bytes_down)?,
        })
    };
    let all: Vec<_> = runs.iter().map(of).collect();
    for (run, less) in runs.iter_mut().zip(all) {
        run.less_than_naive = less;
    }
}

/// Errors of bodies with a record.
fn moving(run: &Run) -> Option<Moving> {
    let mut errors = WithZeros::default();
    for frame in &run.frames {
        errors.extend(&frame.moving_errors_m, 0);
    }
    let body_ticks = errors.count();
    Some(Moving {
        body_ticks,
        surface_error_m: ErrorQuantiles::of(&mut errors)?,
        over_tolerance_share: run.breaches.len() as f64 / body_ticks as f64,
    })
}

/// Factors over the limit.
fn of_limit(figures: &RunFigures) -> Option<OfLimit> {
    let least = figures.limit?;
    Some(OfLimit {
        updates: figures.updates_per_second()? / least.updates_per_second,
        updates_on_grid: figures.updates_per_second()? / least.updates_on_grid_per_second,
        bits: figures.payload_kbps_down? / least.kbps,
    })
}

/// Recovery times of lost packets.
fn recovery(run: &Run) -> Option<Recovery> {
    let mut spans: Vec<u64> = run.recoveries.iter().map(|span| span.as_nanos()).collect();
    let p50_ns = of_nanoseconds(&mut spans, 50)? as f64;
    let p99_ns = of_nanoseconds(&mut spans, 99)? as f64;
    Some(Recovery {
        losses: spans.len() as u64,
        p50_ms: p50_ns / NANOSECONDS_PER_MILLISECOND,
        p99_ms: p99_ns / NANOSECONDS_PER_MILLISECOND,
        p99_ticks: p99_ns / 1e9 / run.config.step_s,
    })
}

/// Fills in the figures that only a run with a network has.
fn add_wire(figures: &mut RunFigures, run: &Run) {
    let config = &run.config;
    let simulated_s = f64::from(config.ticks) * config.step_s;
    let sum = |of: fn(&Frame) -> u64| run.frames.iter().map(of).sum::<u64>();
    let payload = |directions: &[PacketDirection]| -> u64 {
        let counted = run
            .captured
            .iter()
            .filter(|p| directions.contains(&p.direction));
        counted.map(|p| p.counted).sum()
    };
    let bytes_down = sum(bytes_down);
    let payload_down = payload(&[PacketDirection::StateDown, PacketDirection::ControlDown]);
    let updates = sum(|frame| frame.updates);

    figures.link = (!config.link.is_empty()).then(|| config.link.clone());
    figures.bytes_down = Some(bytes_down);
    figures.bytes_up = Some(sum(|f| {
        f.wire_bytes_up + DATAGRAM_HEADER_BYTES * f.wire_datagrams_up
    }));
    figures.payload_bytes_down = Some(payload_down);
    figures.datagrams_down = Some(sum(|frame| frame.wire_datagrams_down));
    if simulated_s > 0.0 {
        figures.payload_kbps_down = Some(kbps(payload_down, simulated_s));
        figures.mean_kbps_down = Some(kbps(bytes_down, simulated_s));
        figures.worst_second_kbps_down =
            second_by_second(run).map(|(_, rate)| rate).reduce(f64::max);
    }
    figures.updates = Some(updates);
    let state_bits = 8 * payload(&[PacketDirection::StateDown]);
    figures.bits_per_update = (updates > 0).then(|| state_bits as f64 / updates as f64);
    let join = run.join;
    figures.join = Some(Join {
        bytes_down: join.wire_bytes_down + DATAGRAM_HEADER_BYTES * join.wire_datagrams_down,
        datagrams_down: join.wire_datagrams_down,
        bytes_up: join.wire_bytes_up + DATAGRAM_HEADER_BYTES * join.wire_datagrams_up,
        datagrams_up: join.wire_datagrams_up,
    });
}

/// Bytes down on the wire in one frame, headers included.
fn bytes_down(frame: &Frame) -> u64 {
    frame.wire_bytes_down + DATAGRAM_HEADER_BYTES * frame.wire_datagrams_down
}

/// For each frame, its tick and the rate down over the simulated second that ends with it, 1,000 bit/s.
///
/// Near the run's start the second reaches back before it, where nothing was sent. A run shorter than a second is
/// divided by its own length.
pub(crate) fn second_by_second(run: &Run) -> impl Iterator<Item = (u64, f64)> + '_ {
    let window = window_ticks(&run.config);
    let span_s = window as f64 * run.config.step_s;
    let mut inside = 0;
    let mut oldest = 0;
    run.frames.iter().map(move |frame| {
        inside += bytes_down(frame);
        let now = frame.tick.value();
        while run.frames[oldest].tick.value() + window <= now {
            inside -= bytes_down(&run.frames[oldest]);
            oldest += 1;
        }
        (now, kbps(inside, span_s))
    })
}

/// Ticks nearest to a second, at most the ticks of the run.
fn window_ticks(config: &RunConfig) -> u64 {
    let ticks = (1.0 / config.step_s).round() as u64;
    ticks.min(u64::from(config.ticks)).max(1)
}

fn kbps(bytes: u64, seconds: f64) -> f64 {
    bytes as f64 * 8.0 / 1e3 / seconds
}

impl ErrorQuantiles {
    /// Quantiles of distances in metres; `None` without distances.
    pub(crate) fn of(errors: &mut WithZeros) -> Option<Self> {
        Some(Self {
            p50: errors.percentile(50)?,
            p95: errors.percentile(95)?,
            p99: errors.percentile(99)?,
            max: errors.percentile(100)?,
        })
    }
}

fn over_tolerance(breaches: &[Breach], body_ticks: u64) -> OverTolerance {
    let mut by_cause: BTreeMap<String, u64> =
        Cause::ALL.map(|cause| (cause.name().to_owned(), 0)).into();
    for breach in breaches {
        *by_cause.entry(breach.cause.name().to_owned()).or_default() += 1;
    }
    let count = breaches.len() as u64;
    OverTolerance {
        count,
        share: count as f64 / (body_ticks.max(1)) as f64,
        by_cause,
    }
}

fn frame_times(frames: &[Frame]) -> Option<FrameTimes> {
    let mut times: Vec<u64> = frames.iter().map(|frame| frame.frame_ns).collect();
    let total: u64 = times.iter().sum();
    Some(FrameTimes {
        p50: of_nanoseconds(&mut times, 50)? as f64 / NANOSECONDS_PER_MILLISECOND,
        p99: of_nanoseconds(&mut times, 99)? as f64 / NANOSECONDS_PER_MILLISECOND,
        mean: total as f64 / frames.len() as f64 / NANOSECONDS_PER_MILLISECOND,
    })
}
