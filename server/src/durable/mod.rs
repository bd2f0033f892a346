//! Scenes that survive the process.
//!
//! A data directory holds a command log and snapshots of each.

mod data_dir;
mod disk;
mod error;
mod examine;
mod frame;
mod head;
mod journal;
mod log_tail;
mod record;
mod recovery;
mod scene_files;
#[cfg(test)]
mod sim_disk;
mod snapshot_file;
#[cfg(test)]
mod tests;
mod writer;

pub use data_dir::DataDir;
pub use error::{Damage, DataError};
pub(crate) use examine::{check, replay};
pub(crate) use journal::Journal;
pub(crate) use log_tail::LogTail;
pub(crate) use record::{Record, SessionNumber};
pub(crate) use recovery::{ReplayStart, Restored};
pub(crate) use scene_files::SceneFiles;
pub(crate) use writer::{Frozen, Origin, SceneLog, Wake};
