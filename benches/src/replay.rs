//! Replays: a recorded scene, published and subscribed to in simulated time.
//!
//! Declarations only: `command` is the task, `session` is one replay.

mod command;
mod config;
mod judge;
mod session;
mod source;

pub use command::{Replay, Sweep, replay};
pub use config::{EnabledFeatures, Feature, ReplayConfig};
pub use session::{ReplayError, run};
pub(crate) use session::{first_track, tally};
pub(crate) use source::{DEFAULT_TOLERANCE, Failure, budget, ended, print_notes};
pub use source::{RecordingSource, ReplayOptions, ToleranceOptions};
