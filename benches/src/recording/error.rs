//! Errors of reading a recording.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use ::mcap::McapError;
use rhumb_protocol::scene::Invalid;
use rhumb_reckoning::Tick;

/// The error of a recording that was not read.
#[derive(Debug)]
pub enum RecordingError {
    /// The file cannot be read.
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The file is no valid recording.
    File {
        /// Path of the file.
        path: PathBuf,
        /// The defect.
        cause: Box<Self>,
    },
    /// The file name ends neither in `.mcap` nor in `.rhtrace.zst`.
    UnknownForm {
        /// Path of the file.
        path: PathBuf,
    },
    /// Decompression failed.
    Unpack(io::Error),
    /// The magic number is missing.
    NotARecording,
    /// The data end too early, or continue after the last frame.
    Length,
    /// The frame count exceeds the limit.
    Frames {
        /// Frame count stated by the file.
        frames: u32,
    },
    /// The step is not the inverse of a whole rate from 1 to 1000 Hz.
    Step {
        /// The step, seconds.
        step_s: f64,
    },
    /// A number is not finite or otherwise invalid.
    Number {
        /// Tick of the record.
        tick: Tick,
    },
    /// Extents out of bounds, or inconsistent with the stated radius.
    Extents {
        /// Index of the body.
        index: u32,
    },
    /// A record of an unknown body, or one out of order.
    Record {
        /// Tick of the record.
        tick: Tick,
        /// Index of the body.
        index: u32,
    },
    /// The MCAP file cannot be read.
    Mcap(McapError),
    /// A message of the MCAP file is not what its topic holds.
    Message(prost::DecodeError),
    /// The truth is missing or incomplete.
    NoTruth,
    /// The scene is unknown, so its gravity is unknown too.
    UnknownScene {
        /// Name of the scene.
        name: String,
    },
    /// The scene's config is out of bounds.
    Terms(Invalid),
}

impl RecordingError {
    pub(super) fn read(path: &Path, cause: io::Error) -> Self {
        Self::Read {
            path: path.to_owned(),
            cause,
        }
    }
}

impl fmt::Display for RecordingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::File { path, cause } => write!(f, "{}: {cause}", path.display()),
            Self::UnknownForm { path } => write!(
                f,
                "{} ends neither in .mcap nor in .rhtrace.zst",
                path.display()
            ),
            Self::Unpack(cause) => write!(f, "the recording cannot be unpacked: {cause}"),
            Self::NotARecording => f.write_str("this is not a recording"),
            Self::Length => f.write_str("the recording ends too early or has trailing bytes"),
            Self::Frames { frames } => write!(
                f,
                "the recording claims {frames} frames, more than are read"
            ),
            Self::Step { step_s } => {
                write!(f, "{step_s} s is no step of a whole rate from 1 to 1000 Hz")
            }
            Self::Number { tick } => write!(f, "a body has an invalid number at {tick}"),
            Self::Extents { index } => write!(f, "body {index} has wrong extents"),
            Self::Record { tick, index } => {
                write!(f, "a record at {tick} is of body {index}, out of order")
            }
            Self::Mcap(cause) => cause.fmt(f),
            Self::Message(cause) => cause.fmt(f),
            Self::NoTruth => f.write_str("the trace does not hold the truth of every tick"),
            Self::UnknownScene { name } => write!(
                f,
                "the trace is of the unknown scene {name:?}, so its gravity is unknown"
            ),
            Self::Terms(invalid) => invalid.fmt(f),
        }
    }
}

impl std::error::Error for RecordingError {}

impl From<McapError> for RecordingError {
    fn from(cause: McapError) -> Self {
        Self::Mcap(cause)
    }
}
