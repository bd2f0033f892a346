//! The figures of an experiment: what `summary.json` says.
//!
//! Computed from the record and from nothing else. A figure that has no meaning for a mode is `null`: a scene stepped
//! in the caller's own thread sends no bytes. A percentile is the least measured value that the given share does not
//! exceed.

mod columns;
mod measure;
mod table;

use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

use crate::record::{Experiment, LimitRates, Replayed, SubscriptionSettings, Unfinished};

use columns::setting;
pub(crate) use columns::{Column, columns};
pub(crate) use measure::second_by_second;
pub use table::SummaryTable;
pub(crate) use table::{aligned, later, markdown, number, ratios};

/// Bytes that IPv4 and UDP add to each datagram.
pub const DATAGRAM_HEADER_BYTES: u64 = 28;

/// Frames of the paper's simulator in a second: its SimFPS is never above it.
pub const SIM_FPS_MAX: f64 = 11.33;

/// One experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The command line, as typed.
    pub command: String,
    /// Seed of the scripts.
    pub seed: u64,
    /// Processor, cores, system.
    pub machine: String,
    /// Every mode's run of every load, in the order of the record.
    pub runs: Vec<RunFigures>,
    /// Replays that did not come to their end, of which there are no figures; left out where there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unfinished: Vec<UnfinishedReplay>,
}

/// A replay that did not come to its end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnfinishedReplay {
    /// How it was asked for, as tables name it.
    pub setting: String,
    /// The link that was simulated; `null` without one.
    pub link: Option<String>,
    /// Seed of that link.
    pub link_seed: u64,
    /// Why, in words.
    pub cause: String,
}

/// One mode's run of one scene at one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunFigures {
    /// Name of the script.
    pub scene: String,
    /// What its load was asked to be.
    pub bodies: u32,
    /// How it was run: `integrated`, `naive`, `rhumb`, `rhumb-pipelined`, `rhumb-free`, `naive-free`,
    /// `replay`.
    pub mode: String,
    /// Frames that the caller is ahead of the server.
    pub depth: u32,
    /// Promised surface error, metres; `null` for a mode that promises the bits.
    pub tolerance_m: Option<f64>,
    /// Bytes a second that the stream's packets could take; `null` without a budget.
    pub budget_bytes_per_second: Option<u32>,
    /// The link that was simulated between the processes; `null` without one.
    pub link: Option<String>,
    /// Ticks that were run.
    pub ticks: u32,
    /// Of a free-running mode: how it was published and followed.
    pub subscription: Option<SubscriptionSettings>,
    /// Of a replay: what only a replay is asked for.
    pub replayed: Option<Replayed>,
    /// Digest of what the engine did: 16 hexadecimal digits, equal for every mode of a load or the load is void.
    pub truth_hash: String,
    /// Whether the engine did something else than in the load's other runs: then nothing of it may be compared.
    pub void: bool,
    /// UDP payload and 28 B of headers per datagram, server to client, whole run after joining.
    pub bytes_down: Option<u64>,
    /// The same, client to server.
    pub bytes_up: Option<u64>,
    /// State datagrams and control stream down, as handed to QUIC.
    pub payload_bytes_down: Option<u64>,
    /// UDP datagrams down.
    pub datagrams_down: Option<u64>,
    /// `payload_bytes_down` over the simulated time of the run, 1,000 bit/s.
    pub payload_kbps_down: Option<f64>,
    /// `bytes_down` over the simulated time of the run, 1,000 bit/s.
    pub mean_kbps_down: Option<f64>,
    /// `bytes_down` of the worst simulated second (the whole run if it is shorter), 1,000 bit/s.
    pub worst_second_kbps_down: Option<f64>,
    /// What came down in the first five simulated seconds, or in all if they are fewer.
    pub first_seconds: Option<FirstSeconds>,
    /// How many times less came down than in the naive run beside it.
    pub less_than_naive: Option<LessThanNaive>,
    /// Updates of single bodies that the client took in.
    pub updates: Option<u64>,
    /// Bits of state datagrams down, as handed to QUIC, for each update.
    pub bits_per_update: Option<f64>,
    /// Of every body that can move, at every frame, against the engine at the same tick.
    pub surface_error_m: Option<ErrorQuantiles>,
    /// Frames without any error because no body was there, or because the truth of their tick never came to be known.
    pub unjudged_frames: Option<u64>,
    /// Body-ticks farther off than promised.
    pub over_tolerance: Option<OverTolerance>,
    /// Sums over tracks in which the two ends were found to differ: a defect.
    pub mismatches: Option<u64>,
    /// Of a replay: of the bodies that the recording has a record of at the tick, against that record.
    pub moving: Option<Moving>,
    /// Of an ablation: payload bytes down over those with every means of the stream on.
    pub of_all_on: Option<f64>,
    /// What was found to do for the same promise, had the future been known; `null` if that was not sought.
    pub limit: Option<LimitRates>,
    /// Updates and payload bits over the fewest that were found to do.
    pub of_limit: Option<OfLimit>,
    /// Of a replay: how long lost packets were missed; `null` if none was lost.
    pub recovery: Option<Recovery>,
    /// What a frame cost the caller's thread.
    pub frame_ms: Option<FrameTimes>,
    /// The paper's measure: one over the mean frame time, and never above [`SIM_FPS_MAX`].
    pub sim_fps: Option<f64>,
    /// What a step cost the engine.
    pub step_ms: StepTimes,
    /// Time spent observing, choosing, encoding and handing over, divided by the time spent stepping.
    pub publish_share: Option<f64>,
    /// What it cost to come in, before the first frame.
    pub join: Option<Join>,
}

/// Distances that no point of a body exceeds, metres: |Δp| + 2 r sin(Δθ/2), r the bounding radius.
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

/// Body-ticks farther off than promised.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OverTolerance {
    /// How many.
    pub count: u64,
    /// Of all body-ticks of bodies that can move.
    pub share: f64,
    /// How many for each cause: `loss`, `late`, and `fault`, which must be zero.
    pub by_cause: BTreeMap<String, u64>,
}

/// How far off those bodies were that moved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Moving {
    /// Records of bodies, which are counted here and nowhere else.
    pub body_ticks: u64,
    /// Of them.
    pub surface_error_m: ErrorQuantiles,
    /// Body-ticks farther off than promised, of any body, divided by `body_ticks`.
    pub over_tolerance_share: f64,
}

/// What came down at the beginning, where a scene is busiest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FirstSeconds {
    /// How long, simulated.
    pub seconds: f64,
    /// As `payload_bytes_down`.
    pub payload_bytes_down: u64,
    /// As `bytes_down`: with headers.
    pub bytes_down: u64,
}

/// Bytes down of the naive run over those of this one.
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

/// Times what was found to do, had the future been known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OfLimit {
    /// Updates over the fewest.
    pub updates: f64,
    /// Updates over the fewest with motions on the protocol's grid.
    pub updates_on_grid: f64,
    /// Payload bits down over the fewest.
    pub bits: f64,
}

/// From the sending of a packet that was lost until all of its bodies were known again, as of its tick or later.
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

/// What frames cost, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// All together divided by their number.
    pub mean: f64,
}

/// What steps cost, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StepTimes {
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// What it cost to come in: bytes with 28 B of headers for each datagram, and datagrams.
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

impl Summary {
    /// The figures of an experiment.
    #[must_use]
    pub fn of(experiment: &Experiment) -> Self {
        let runs = experiment.loads.iter().flat_map(|load| {
            let figures = |run| measure::figures(run, load.truth.digest);
            load.runs.iter().map(figures)
        });
        let mut runs: Vec<_> = runs.collect();
        measure::compare_with_naive(&mut runs);
        measure::compare_with_all_on(&mut runs);
        let unfinished = experiment.loads.iter().flat_map(|load| &load.unfinished);
        Self {
            command: experiment.command.clone(),
            seed: experiment.seed,
            machine: experiment.machine.clone(),
            runs,
            unfinished: unfinished.map(UnfinishedReplay::of).collect(),
        }
    }

    /// As the text of `summary.json`.
    #[must_use]
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self)
            .expect("numbers, texts and maps keyed by texts are always JSON");
        text.push('\n');
        text
    }

    /// Whether all runs are replays of recordings.
    #[must_use]
    pub fn is_of_replays(&self) -> bool {
        !self.runs.is_empty() && self.runs.iter().all(|run| run.replayed.is_some())
    }

    /// How many times less than naive each run took, as lines for a terminal; empty without a naive run.
    #[must_use]
    pub fn ratios(&self) -> String {
        let rows = ratios(&self.runs);
        if rows.len() < 2 {
            return String::new();
        }
        format!("\nless than naive, times\n{}", aligned(&rows))
    }

    /// As a table for a terminal.
    #[must_use]
    pub const fn table(&self) -> SummaryTable<'_> {
        SummaryTable::new(self)
    }
}

impl UnfinishedReplay {
    fn of(unfinished: &Unfinished) -> Self {
        let config = &unfinished.config;
        let replayed = config.replayed.as_ref();
        let setting =
            replayed.map(|of| setting(of, config.tolerance_m, config.budget_bytes_per_second));
        Self {
            setting: setting.unwrap_or_else(|| config.mode.name().to_owned()),
            link: (!config.link.is_empty()).then(|| config.link.clone()),
            link_seed: replayed.map_or(config.seed, |of| of.link_seed),
            cause: unfinished.cause.clone(),
        }
    }
}

impl fmt::Display for UnfinishedReplay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.setting)?;
        if let Some(link) = &self.link {
            write!(f, ", {link}, seed {}", self.link_seed)?;
        }
        write!(f, ": {}", self.cause)
    }
}

impl RunFigures {
    /// Updates taken in for each simulated second.
    #[must_use]
    pub fn updates_per_second(&self) -> Option<f64> {
        let (bytes, kbps) = (self.bytes_down?, self.mean_kbps_down?);
        let simulated_s = bytes as f64 * 8.0 / 1e3 / kbps;
        Some(self.updates? as f64 / simulated_s)
    }

    /// The naive run that this one is measured against: of a free-running scene the one that follows the same server.
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

    /// The run of another mode that differs from this one in nothing but the mode and what comes with it.
    #[must_use]
    pub fn beside<'a>(&self, runs: &'a [Self], mode: &str) -> Option<&'a Self> {
        let same = |run: &&Self| run.scene == self.scene && run.bodies == self.bodies;
        let mut of_mode = runs.iter().filter(same).filter(|run| run.mode == mode);
        let first = of_mode.clone().next();
        of_mode.find(|run| run.link == self.link).or(first)
    }
}
