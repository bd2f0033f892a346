//! Reasons why stored scenes cannot be written or restored.
//!
//! Each names the file, and what is lost.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use rhumb_reckoning::Tick;
use rhumb_transport::CertificateError;

/// Reason why a data directory or a scene in it cannot be used.
#[derive(Debug)]
pub enum DataError {
    /// The system refused.
    Io {
        /// The file or directory.
        path: PathBuf,
        /// The operation that failed.
        doing: &'static str,
        /// The system's error.
        cause: io::Error,
    },
    /// A limit on the bytes of scenes is reached.
    Full {
        /// The directory of all scenes.
        path: PathBuf,
        /// The limit's name.
        limit: &'static str,
        /// Bytes that there are.
        bytes: u64,
        /// Bytes that there may be.
        most: u64,
    },
    /// Another process uses the directory.
    InUse {
        /// The directory.
        path: PathBuf,
    },
    /// No certificate for development can be made.
    Certificate(CertificateError),
    /// A file of a scene is not what was written.
    Damaged {
        /// The file.
        path: PathBuf,
        /// Its fault.
        damage: Damage,
    },
}

/// Fault of a file of a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Damage {
    /// Bytes from a place on are lost or changed; records after a tick are lost.
    Bytes {
        /// The place of the first damaged frame.
        at: u64,
        /// The newest tick before it.
        after: Tick,
    },
    /// Bytes that were durable are lost or changed at the end of the newest segment.
    End {
        /// The place of the first lost frame.
        at: u64,
        /// Bytes that were durable.
        of: u64,
        /// The newest tick before it.
        after: Tick,
        /// The newest tick that was durable at least.
        through: Tick,
    },
    /// The file that says how far the log is durable is not readable.
    Head,
    /// The beginning is lost or changed, and with it the whole file.
    Beginning,
    /// The file is missing.
    Missing,
    /// A frame is whole, but is not of this version.
    Unreadable {
        /// The tick before its records.
        after: Tick,
    },
    /// The run from this file differs from the one that was recorded.
    Diverged {
        /// The first tick that differs.
        at: Tick,
    },
    /// A snapshot is not authentic: it is damaged, or of another data directory.
    NotAuthentic,
    /// A log or a snapshot of another version of the engine or of this program.
    Version {
        /// The version in the file.
        found: String,
    },
}

impl DataError {
    pub(super) fn io(path: &Path, doing: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |cause| Self::Io { path, doing, cause }
    }

    pub(super) fn damaged(path: &Path, damage: Damage) -> Self {
        Self::Damaged {
            path: path.to_owned(),
            damage,
        }
    }
}

impl fmt::Display for DataError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Io { path, doing, cause } => {
                write!(f, "cannot {doing} {}: {cause}", path.display())
            }
            Self::Full {
                path,
                limit,
                bytes,
                most,
            } => write!(
                f,
                "{} has {bytes} bytes of the {most} that limits.{limit} allows: delete scenes, or raise the limit",
                path.display()
            ),
            Self::InUse { path } => {
                write!(f, "another process uses the directory {}", path.display())
            }
            Self::Certificate(cause) => cause.fmt(f),
            Self::Damaged { path, damage } => write!(f, "{}: {damage}", path.display()),
        }
    }
}

impl std::error::Error for DataError {}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bytes { at, after } => write!(
                f,
                "damaged at byte {at}; what happened after tick {} is lost",
                after.value()
            ),
            Self::End {
                at,
                of,
                after,
                through,
            } => write!(
                f,
                "damaged or cut at byte {at} of {of}; what happened after tick {} is lost, to tick {} at least",
                after.value(),
                through.value()
            ),
            Self::Head => {
                f.write_str("damaged; how far the log beside it was durable is not known")
            }
            Self::Beginning => {
                f.write_str("damaged at its beginning; everything recorded in it is lost")
            }
            Self::Missing => f.write_str("missing; everything recorded in it is lost"),
            Self::Unreadable { after } => write!(
                f,
                "a record after tick {} is not of this version",
                after.value()
            ),
            Self::Diverged { at } => write!(
                f,
                "the run from it differs from the recorded one at tick {}; \
                 another version of the program may have written it",
                at.value()
            ),
            Self::NotAuthentic => f.write_str("damaged, or not written with this directory's key"),
            Self::Version { found } => write!(f, "written by another version, {found}"),
        }
    }
}
