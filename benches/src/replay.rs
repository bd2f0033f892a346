//! Replays: a recorded scene, published and subscribed to in simulated time.
//!
//! Declarations only: `command` is the task, `session` is one replay.

mod client;
mod command;
mod config;
mod failure;
mod feature;
mod judge;
mod plain;
mod session;
mod source;
mod sweep;

pub use command::{Replay, replay};
pub use config::ReplayConfig;
pub(crate) use failure::{Failure, ended};
pub use feature::{EnabledFeatures, Feature};
pub(crate) use plain::tally;
pub(crate) use session::first_track;
pub use session::{ReplayError, run};
pub(crate) use source::{DEFAULT_TOLERANCE, budget, print_notes};
pub use source::{RecordingSource, ReplayOptions, ToleranceOptions};
pub use sweep::Sweep;
