//! The results of an ablation: `ablation.json`.

use serde::{Deserialize, Serialize};

use crate::record::{Cause, PacketDirection, Run};

/// Content of `ablation.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
    /// The link with delay and loss.
    pub link: String,
    /// Seeds of that link, from 1 on.
    pub seeds: u64,
    /// The loads.
    pub loads: Vec<AblationLoad>,
    /// Body-ticks beyond the tolerance without a cause, in all replays: a defect.
    pub faults: u64,
    /// One row per mechanism.
    pub rows: Vec<AblationRow>,
}

/// One load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationLoad {
    /// Its name.
    pub name: String,
    /// Scene or file.
    pub source: String,
    /// Number of dynamic bodies.
    pub bodies: u32,
    /// Number of ticks.
    pub ticks: u32,
    /// Tolerance, metres.
    pub tolerance_m: f64,
    /// Tolerance of the rotation, where it has one of its own, radians.
    pub turn_rad: Option<f64>,
    /// Ticks between publications.
    pub publish_interval: u32,
}

/// One mechanism.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationRow {
    /// The mechanism.
    pub name: String,
    /// The feature that users name, if the mechanism is one.
    pub feature: Option<String>,
    /// Name of the switch, as `replay --without` has it; `null` if the mechanism cannot be switched off.
    pub without: Option<String>,
    /// Ticks of lookahead with which it is measured.
    pub lookahead_ticks: u32,
    /// Lines of code.
    pub lines: u64,
    /// Requirements of the specification.
    pub requirements: u64,
    /// One per load.
    pub comparisons: Vec<Comparison>,
}

impl AblationRow {
    /// True if the mechanism can be switched off.
    #[must_use]
    pub const fn is_measured(&self) -> bool {
        self.without.is_some()
    }
}

/// One mechanism on one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Name of the load.
    pub load: String,
    /// With the mechanism: over a perfect link, and over the one with loss.
    pub with: [Sent; 2],
    /// The same without it.
    pub without: [Sent; 2],
}

/// Figures of a replay, or their means over several seeds; `null` where a replay failed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sent {
    /// Bytes handed to QUIC.
    pub payload_bytes: Option<f64>,
    /// Share of moving body-ticks beyond the tolerance.
    pub over_share: Option<f64>,
    /// Processor time of publishing, divided by the number of updates, nanoseconds.
    pub publish_ns_per_update: Option<f64>,
    /// Cause of a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
}

impl Sent {
    /// Figures of one replay.
    pub(super) fn of(run: &Run) -> Self {
        let down = [PacketDirection::StateDown, PacketDirection::ControlDown];
        let down = run
            .captured
            .iter()
            .filter(|captured| down.contains(&captured.direction));
        let bytes: u64 = down.map(|captured| captured.counted).sum();
        let body_ticks: usize = run.frames.iter().map(|f| f.moving_errors_m.len()).sum();
        let updates: u64 = run.frames.iter().map(|frame| frame.updates).sum();
        let ratio = |part: f64, all: f64| (all > 0.0).then(|| part / all);
        Self {
            payload_bytes: Some(bytes as f64),
            over_share: ratio(run.breaches.len() as f64, body_ticks as f64),
            publish_ns_per_update: ratio(run.publish_ns_total as f64, updates as f64),
            failed: None,
        }
    }

    /// No figures.
    pub(super) fn failed(cause: String) -> Self {
        Self {
            failed: Some(cause),
            ..Self::default()
        }
    }

    /// The means of some replays.
    pub(super) fn mean(all: &[Self]) -> Self {
        let mean = |figure: fn(&Self) -> Option<f64>| {
            let figures: Option<Vec<f64>> = all.iter().map(figure).collect();
            let figures = figures.filter(|figures| !figures.is_empty())?;
            Some(figures.iter().sum::<f64>() / figures.len() as f64)
        };
        Self {
            payload_bytes: mean(|sent| sent.payload_bytes),
            over_share: mean(|sent| sent.over_share),
            publish_ns_per_update: mean(|sent| sent.publish_ns_per_update),
            failed: None,
        }
    }
}

/// Body-ticks beyond the tolerance without a cause.
pub(super) fn faults(run: &Run) -> u64 {
    let unexplained = run
        .breaches
        .iter()
        .filter(|breach| breach.cause == Cause::Fault);
    unexplained.count() as u64
}
