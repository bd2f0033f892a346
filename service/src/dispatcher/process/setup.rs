//! The settings that a worker process gets from its dispatcher.

use std::num::NonZeroU32;
use std::path::PathBuf;

use rhumb_scene::Limits;
use rhumb_scene::engine::EngineKind;
use serde::{Deserialize, Serialize};
use tracing::level_filters::LevelFilter;

/// How worker processes are started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProcessOptions {
    /// True if all scenes without a tenant share a process.
    pub(crate) share: bool,
    pub(crate) log: LevelFilter,
    /// Threads that step and publish, in each process.
    pub(crate) threads: NonZeroU32,
    /// Directory in which each process records its scenes.
    pub(crate) record: Option<PathBuf>,
}

/// The settings of a worker process.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct WorkerSetup {
    /// The process id of the dispatcher.
    pub(super) dispatcher: u32,
    /// The dispatcher's clock at the start of the process, nanoseconds.
    pub(super) now_ns: u64,
    pub(super) limits: Limits,
    /// Bytes of the largest packet of a stream.
    pub(super) largest_packet: u32,
    pub(super) engine: EngineKind,
    /// Threads that step and publish.
    pub(super) threads: NonZeroU32,
    /// The data directory, whose lock the process has inherited.
    pub(super) data: Option<PathBuf>,
    /// The log level, as text.
    pub(super) log: String,
    /// True if the dispatcher keeps flight recorders.
    pub(super) records_flights: bool,
    /// The directory for recordings of its scenes.
    pub(super) record: Option<PathBuf>,
}
