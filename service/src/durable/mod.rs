//! Scenes that survive the process.
//!
//! A data directory holds a command log and snapshots of each.

mod data_dir;
mod disk;
mod error;
mod examine;
mod frame;
mod recovery;
mod scene_files;
#[cfg(test)]
mod sim_disk;
mod snapshot_file;
mod stored_scenes;
#[cfg(test)]
mod tests;
mod writer;

pub(crate) use self::recovery::LogTail;
pub use data_dir::DataDir;
pub use error::{Damage, DataError};
pub(crate) use examine::{check, replay};
pub(crate) use stored_scenes::StoredScenes;
pub(crate) use writer::Wake;
