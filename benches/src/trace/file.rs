//! A trace's file: it gets its final name only when complete.
//!
//! An unfinished file is removed on drop.

use std::ffi::OsString;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::{fmt, fs, io};

use mcap::McapError;

/// The file while it is written.
#[derive(Debug)]
pub(super) struct Partial {
    path: PathBuf,
    named: PathBuf,
    sink: BufWriter<File>,
    finished: bool,
}

impl Partial {
    /// Opens `named` with `.partial` appended; replaces an existing file.
    pub(super) fn create(named: &Path) -> Result<Self, TraceError> {
        let mut path = OsString::from(named);
        path.push(".partial");
        let path = PathBuf::from(path);
        match File::create(&path) {
            Ok(file) => Ok(Self {
                path,
                named: named.to_owned(),
                sink: BufWriter::new(file),
                finished: false,
            }),
            Err(cause) => Err(TraceError::Create { path, cause }),
        }
    }

    /// The writer of the unfinished file.
    pub(super) fn sink(&mut self) -> &mut BufWriter<File> {
        &mut self.sink
    }

    /// The temporary path.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the file to its final name; returns its size in bytes.
    pub(super) fn finish(mut self) -> Result<u64, TraceError> {
        let path = self.path.clone();
        let whole = self.sink.flush().and_then(|()| {
            self.sink.get_ref().sync_all()?;
            Ok(self.sink.get_ref().metadata()?.len())
        });
        let bytes = whole.map_err(|cause| TraceError::Write { path, cause })?;
        if let Err(cause) = fs::rename(&self.path, &self.named) {
            return Err(TraceError::Rename {
                path: self.named.clone(),
                cause,
            });
        }
        self.finished = true;
        Ok(bytes)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.finished {
            // The caller already has the error that matters.
            let _ = fs::remove_file(&self.path);
        }
    }
}

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
