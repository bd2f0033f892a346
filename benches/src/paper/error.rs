//! Why a task of `rhumb-bench paper` did not come to its end.

use std::fmt;
use std::io;
use std::path::PathBuf;

use rhumb_server::RunError;

use super::settings::Difference;
use crate::drive::DriveError;
use crate::output::OutputError;
use crate::record::Mode;

/// Why a task did not come to its end.
#[derive(Debug)]
pub(super) enum PaperError {
    /// A run failed.
    Drive(DriveError),
    /// The cores cannot be chosen.
    Cores(RunError),
    /// Something cannot be written.
    Output(OutputError),
    /// A file or folder cannot be read.
    Read { path: PathBuf, cause: io::Error },
    /// A file holds something else than this program wrote.
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
    /// Nothing would be left to compare with.
    NoIntegrated,
    /// The tolerance is none.
    Tolerance { metres: f64, cause: String },
    /// There is nothing to merge, or it does not fit together.
    Merge { why: String },
    /// A page's markers are wrong.
    Page { path: PathBuf, why: String },
    /// A page says something else than its files.
    Stale { path: PathBuf, blocks: Vec<String> },
    /// The caller cannot be made weak.
    Quota { why: String },
}

impl fmt::Display for PaperError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drive(cause) => cause.fmt(f),
            Self::Cores(cause) => write!(
                f,
                "{cause}; a task that has --no-pin leaves them to the system by it"
            ),
            Self::Output(cause) => cause.fmt(f),
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::NotOurs { path, cause } => write!(
                f,
                "{} is not what this program wrote there: {cause}",
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
                "{path} does not say what its files say: {}; `rhumb-bench paper page {path}` mends it",
                blocks.join(", "),
                path = path.display(),
            ),
            Self::Quota { why } => write!(f, "the caller cannot be made weak: {why}"),
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
