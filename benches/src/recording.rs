//! Recorded motion of a scene: the input of a replay.
//!
//! ```text
//!   trace.mcap, a server's recording ──▶ states of a load ───────────────────┐
//!   .rhtrace.zst ──▶ records by frame ────────────────────────────────────────┼─▶ Recording
//!   MCAP of others, CSV ──▶ poses by time ──▶ frames of a constant rate ──────┘
//! ```
//!
//! A recording is checked when it is read, so a replay can rely on it. What the file does not say, or lacks, is a note.

mod activity;
mod csv;
mod error;
mod foxglove;
pub mod mcap;
mod options;
mod play;
mod poses;
mod rate;
mod read;
mod recorded;
pub mod rhtrace;
mod states;
mod velocity;

pub use error::{Place, RecordingError, RowDefect};
pub use options::{MissingPoses, ReadOptions, ShapeChoice};
pub(crate) use read::hertz;
pub use read::read;
pub use recorded::{Recording, ScriptOrigin};
