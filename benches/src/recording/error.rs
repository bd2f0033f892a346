//! Why a recording was not read.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use ::mcap::McapError;
use rhumb_protocol::scene::Invalid;
use rhumb_reckoning::Tick;

/// Why a recording was not read.
#[derive(Debug)]
pub enum RecordingError {
    /// The file cannot be read.
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        cause: io::Error,
    },
    /// The file is none that can be replayed.
    File {
        /// Which.
        path: PathBuf,
        /// Why not.
        cause: Box<Self>,
    },
    /// The file's ending is neither `.mcap` nor `.rhtrace.zst`.
    UnknownForm {
        /// Which.
        path: PathBuf,
    },
    /// It cannot be unpacked.
    Unpack(io::Error),
    /// It does not begin as a recording does.
    NotARecording,
    /// It ends too soon, or goes on behind its end.
    Length,
    /// More frames than are read.
    Frames {
        /// How many it claims to have.
        frames: u32,
    },
    /// Its step is no whole number of ticks in so many seconds, from 1 to 1000 a second.
    Step {
        /// Seconds.
        step_s: f64,
    },
    /// A number that no engine would give.
    Number {
        /// When.
        tick: Tick,
    },
    /// A body whose extents are out of bounds, or do not fit the radius that is told with them.
    Extents {
        /// Which.
        index: u32,
    },
    /// A record of a body that there is not, or one that comes before a body of a lower number.
    Record {
        /// When.
        tick: Tick,
        /// Of which body.
        index: u32,
    },
    /// The MCAP file cannot be read.
    Mcap(McapError),
    /// A message of the MCAP file is not what its topic holds.
    Message(prost::DecodeError),
    /// There is no truth in it, or not of every tick.
    NoTruth,
    /// It is of a scene that is not known here, so that nothing tells what pulled in it.
    UnknownScene {
        /// Its name.
        name: String,
    },
    /// The config that were asked for are out of bounds.
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
            Self::Length => f.write_str("the recording ends too soon or too late"),
            Self::Frames { frames } => write!(
                f,
                "the recording claims {frames} frames, more than are read"
            ),
            Self::Step { step_s } => {
                write!(f, "{step_s} s is no step of a whole rate from 1 to 1000 Hz")
            }
            Self::Number { tick } => write!(f, "a body has a number that is none at {tick}"),
            Self::Extents { index } => write!(f, "body {index} has wrong extents"),
            Self::Record { tick, index } => {
                write!(f, "a record at {tick} is of body {index}, out of order")
            }
            Self::Mcap(cause) => cause.fmt(f),
            Self::Message(cause) => cause.fmt(f),
            Self::NoTruth => f.write_str("the trace does not hold the truth of every tick"),
            Self::UnknownScene { name } => write!(
                f,
                "the trace is of {name:?}, which is no scene here: nothing tells its gravity"
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
