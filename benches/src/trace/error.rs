//! Errors of writing a trace.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use mcap::McapError;

/// The cause and the file. A failed trace never keeps its final name.
#[derive(Debug)]
pub enum TraceError {
    /// The file could not be created.
    Create {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// Writing failed, most often because of a full disk.
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The data exceed what the file format can hold.
    Format {
        /// Path of the file.
        path: PathBuf,
        /// Error of the format's library.
        cause: Box<McapError>,
    },
    /// The finished file could not be renamed.
    Rename {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
}

impl TraceError {
    /// Separates the operating system's errors from the format's.
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
