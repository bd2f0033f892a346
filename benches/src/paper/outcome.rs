//! What one trial found: each mode at each load.

use serde::{Deserialize, Serialize};

/// One run through all loads with one seed, all modes in turn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct ExperimentTrial {
    /// CountSink from 1.
    pub(super) number: u32,
    /// Of the script.
    pub(super) seed: u64,
    /// How long it took, seconds.
    pub(super) wall_s: f64,
    /// In ascending order.
    pub(super) loads: Vec<LoadOutcome>,
}

/// What was found with so many balls.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct LoadOutcome {
    /// Balls in the pit.
    pub(super) load: u32,
    /// In the order of the settings.
    pub(super) modes: Vec<ModeOutcome>,
}

/// One mode at one load. Times are milliseconds; bytes have headers counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ModeOutcome {
    /// Its name.
    pub(super) mode: String,
    /// Frames that were measured.
    pub(super) frames: u32,
    /// From calling advance to having every pose of the frame that the call returns, on average.
    pub(super) phys_ft_ms: f64,
    /// The median.
    pub phys_ft_p50_ms: f64,
    /// One in a hundred takes longer.
    pub phys_ft_p99_ms: f64,
    /// The longest.
    pub(super) phys_ft_max_ms: f64,
    /// Of the average, what the caller's thread worked; the rest it waited. None where the system does not tell.
    pub(super) work_ms: Option<f64>,
    /// Frames over their time, none shorter than 1/11.33 s.
    pub(super) sim_fps: f64,
    /// The same if a frame also takes as long as the server: what a caller ahead of it can keep up.
    pub(super) sustained_fps: f64,
    /// The engine's step, in a frame.
    pub(super) step_ms: f64,
    /// Looking at what moved.
    pub(super) observe_ms: f64,
    /// StreamSelection, encoding and handing over what to say.
    pub(super) publish_ms: f64,
    /// Bodies awake at the end.
    pub(super) awake: u32,
    /// On the wire to the caller.
    pub(super) bytes_down: u64,
    /// On the wire to the server.
    pub(super) bytes_up: u64,
    /// Datagrams to the caller.
    pub(super) datagrams_down: u64,
    /// Motions said.
    pub(super) updates: u64,
    /// Of a client of the paper's protocol: frames whose end it did not hear.
    #[serde(default)]
    pub(super) ends_lost: u64,
    /// Digest of all that its engine did so far.
    pub(super) truth: String,
    /// Whether its engine did not do what the integrated one did: then nothing of this counts.
    pub(super) void: bool,
}
