//! The figures of one run.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::record::{LimitRates, Replayed, SubscriptionSettings};

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
    /// Their surface errors.
    pub surface_error_m: ErrorQuantiles,
    /// Body-ticks of any body over tolerance, divided by `body_ticks`.
    pub over_tolerance_share: f64,
}

/// Traffic down at the start, where a scene is busiest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FirstSeconds {
    /// Length of the span, simulated seconds.
    pub seconds: f64,
    /// As `payload_bytes_down`.
    pub payload_bytes_down: u64,
    /// As `bytes_down`: with headers.
    pub bytes_down: u64,
}

/// Bytes down of the naive run divided by those of this run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LessThanNaive {
    /// Payload, whole run.
    pub payload: f64,
    /// With headers, whole run.
    pub with_headers: f64,
    /// Payload, first seconds.
    pub payload_first: f64,
    /// With headers, first seconds.
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
