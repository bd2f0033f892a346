//! Why a trace was not written.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use mcap::McapError;

/// What went wrong, and with which file. No trace is left behind that looks finished.
#[derive(Debug)]
pub enum TraceError {
    /// The file could not be made.
    Create {
        /// Which.
        path: PathBuf,
        /// As the system has it.
        cause: io::Error,
    },
    /// The file took no more: a full disk, most of the time.
    Write {
        /// Which.
        path: PathBuf,
        /// As the system has it.
        cause: io::Error,
    },
    /// More than the file format can hold.
    Format {
        /// Which.
        path: PathBuf,
        /// As the format's library has it.
        cause: Box<McapError>,
    },
    /// The finished file could not be given its name.
    Rename {
        /// Which.
        path: PathBuf,
        /// As the system has it.
        cause: io::Error,
    },
}

impl TraceError {
    /// Tells the system's errors from the format's.
    pub(super) fn writing(path: &Path, cause: McapError) -> Self {
        let path = path.to_owned();
        match cause {
            McapError::Io(cause) => Self::Write { path, cause },
            other => Self::Format {
                path,
                cause: Box::new(other),
            },
        }
    }
}

impl fmt::Display for TraceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Create { path, cause } => write!(f, "cannot create {}: {cause}", path.display()),
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Format { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Rename { path, cause } => write!(f, "cannot rename {}: {cause}", path.display()),
        }
    }
}

impl std::error::Error for TraceError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Create { cause, .. } | Self::Write { cause, .. } | Self::Rename { cause, .. } => {
                Some(cause)
            }
            Self::Format { cause, .. } => Some(cause),
        }
    }
}
