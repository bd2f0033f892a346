//! Replays: a recorded scene, published and subscribed to in simulated time.
//!
//! Declarations only: `command` is the task, `session` is one replay.

mod command;
mod config;
mod judge;
mod session;

pub use command::{Replay, Sweep, replay};
pub(crate) use config::budget;
pub use config::{EnabledFeatures, Feature, ReplayConfig, ReplayOptions};
pub(crate) use session::tally;
pub use session::{ReplayError, run};
