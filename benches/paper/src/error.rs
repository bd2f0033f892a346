//! Errors of the tasks of `rhumb-paper`.

use std::fmt;
use std::io;
use std::path::PathBuf;

use rhumb_server::RunError;

use super::settings::Difference;
use rhumb_bench::drive::DriveError;
use rhumb_bench::output::OutputError;
use rhumb_bench::record::Mode;

/// The error of a task.
#[derive(Debug)]
pub(crate) enum PaperError {
    /// A run failed.
    Drive(DriveError),
    /// The cores cannot be chosen.
    Cores(RunError),
    /// An output cannot be written.
    Output(OutputError),
    /// A file or folder cannot be read.
    Read { path: PathBuf, cause: io::Error },
    /// A file has another format than this program writes.
    NotOurs {
        path: PathBuf,
        cause: serde_json::Error,
    },
    /// The folder holds trials of other settings or of another machine.
    OtherExperiment {
        folder: PathBuf,
        difference: Difference,
    },
    /// A mode cannot take part.
    NotPlayable { mode: Mode },
    /// The baseline mode is missing.
    NoIntegrated,
    /// The tolerance is invalid.
    Tolerance { metres: f64, cause: String },
    /// The merge has no input, or inconsistent input.
    Merge { why: String },
    /// A page's markers are wrong.
    Page { path: PathBuf, why: String },
    /// A page is stale.
    Stale { path: PathBuf, blocks: Vec<String> },
    /// The caller cannot be slowed.
    Quota { why: String },
}

impl fmt::Display for PaperError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drive(cause) => cause.fmt(f),
            Self::Cores(cause) => write!(f, "{cause}; tasks with --no-pin let the system choose"),
            Self::Output(cause) => cause.fmt(f),
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::NotOurs { path, cause } => write!(
                f,
                "{} does not have the format that this program writes: {cause}",
                path.display()
            ),
            Self::OtherExperiment { folder, difference } => write!(
                f,
                "{} holds trials of another experiment ({difference}); choose another --out, or remove it",
                folder.display()
            ),
            Self::NotPlayable { mode } => write!(f, "{mode} cannot take part in this experiment"),
            Self::NoIntegrated => {
                f.write_str("--modes must name integrated: all others are compared with it")
            }
            Self::Tolerance { metres, cause } => write!(f, "a tolerance of {metres} m: {cause}"),
            Self::Merge { why } => write!(f, "cannot merge: {why}"),
            Self::Page { path, why } => write!(f, "{}: {why}", path.display()),
            Self::Stale { path, blocks } => write!(
                f,
                "{path} is stale: {}; `rhumb-paper page {path}` updates it",
                blocks.join(", "),
                path = path.display(),
            ),
            Self::Quota { why } => write!(f, "the caller cannot be slowed: {why}"),
        }
    }
}

impl From<DriveError> for PaperError {
    fn from(cause: DriveError) -> Self {
        Self::Drive(cause)
    }
}

impl From<OutputError> for PaperError {
    fn from(cause: OutputError) -> Self {
        Self::Output(cause)
    }
}
