//! Outcomes of one trial: each mode at each load.

use serde::{Deserialize, Serialize};

/// One run through all loads with one seed, all modes in turn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ExperimentTrial {
    /// Number of the trial, from 1.
    pub(crate) number: u32,
    /// Seed of the script.
    pub(crate) seed: u64,
    /// Duration, seconds.
    pub(crate) wall_s: f64,
    /// Loads in ascending order.
    pub(crate) loads: Vec<LoadOutcome>,
}

/// Outcomes at one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoadOutcome {
    /// Balls in the pit.
    pub(crate) load: u32,
    /// Modes in the order of the settings.
    pub(crate) modes: Vec<ModeOutcome>,
}

/// One mode at one load. Times are milliseconds; bytes include headers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ModeOutcome {
    /// Name of the mode.
    pub(crate) mode: String,
    /// Number of measured frames.
    pub(crate) frames: u32,
    /// Mean time from calling advance to having every pose of the returned frame.
    pub(crate) phys_ft_ms: f64,
    /// Median of the same.
    pub phys_ft_p50_ms: f64,
    /// 99th percentile of the same.
    pub phys_ft_p99_ms: f64,
    /// Maximum of the same.
    pub(crate) phys_ft_max_ms: f64,
    /// Mean processor time of the caller's thread; the rest is waiting. `None` where the system does not report it.
    pub(crate) work_ms: Option<f64>,
    /// Frames over their time, each counted as 1/11.33 s at least.
    pub(crate) sim_fps: f64,
    /// The same, limited by the server's time too: the rate that a pipelined caller can sustain.
    pub(crate) sustained_fps: f64,
    /// Engine steps per frame.
    pub(crate) step_ms: f64,
    /// Time of observing per frame.
    pub(crate) observe_ms: f64,
    /// Time of selecting, encoding and queueing per frame.
    pub(crate) publish_ms: f64,
    /// Bodies awake at the end.
    pub(crate) awake: u32,
    /// Bytes on the wire to the caller.
    pub(crate) bytes_down: u64,
    /// Bytes on the wire to the server.
    pub(crate) bytes_up: u64,
    /// Datagrams to the caller.
    pub(crate) datagrams_down: u64,
    /// Updates sent.
    pub(crate) updates: u64,
    /// Client of the paper's protocol: frames whose end message was lost.
    #[serde(default)]
    pub(crate) ends_lost: u64,
    /// Digest of all states of its engine so far.
    pub(crate) truth: String,
    /// True if its engine diverged from the integrated one; such an outcome is excluded.
    pub(crate) void: bool,
}
