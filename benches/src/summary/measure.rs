//! Computes one run's figures from its frames.
//!
//! Decides sums and divisors; the meaning of each figure is documented at its field.

use std::collections::BTreeMap;

use crate::quantile::{WithZeros, of_nanoseconds};
use crate::record::{Breach, CapturedPacket, Cause, Frame, Mode, PacketDirection, Run, RunConfig};

use super::run_figures::{
    DATAGRAM_HEADER_BYTES, ErrorQuantiles, FirstSeconds, FrameTimes, Join, LessThanNaive, Moving,
    OfLimit, OverTolerance, Recovery, RunFigures, SIM_FPS_MAX, StepTimes,
};

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
