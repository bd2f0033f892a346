//! Recorded motion of a scene: the input of a replay.
//!
//! Two formats are read: the truth in a `trace.mcap` ([`mcap`]) and foreign recordings ([`rhtrace`]). A recording is
//! checked when it is read, so a replay can rely on it.

mod error;
pub mod mcap;
mod play;
mod read;
mod recorded;
pub mod rhtrace;

pub use error::RecordingError;
pub use read::read;
pub use recorded::{Recording, ScriptOrigin};
