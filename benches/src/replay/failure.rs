//! Errors of tasks on a recording.

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use super::session::ReplayError;
use crate::output::OutputError;
use crate::recording::RecordingError;

/// The error of a task on a recording.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The recording cannot be read.
    Recording(RecordingError),
    /// All of this many replays failed; the first one's error.
    Replay(usize, ReplayError),
    /// Number of failed replays and of all replays; the results of the others are written.
    Unfinished(usize, usize),
    /// An output cannot be written.
    Output(OutputError),
    /// Invalid arguments, as text.
    Terms(String),
}

/// Exit code 0 on success; otherwise prints the failure to standard error and returns 1.
pub(crate) fn ended(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {failure}");
            ExitCode::FAILURE
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recording(cause) => cause.fmt(f),
            Self::Replay(1, cause) => cause.fmt(f),
            Self::Replay(all, cause) => {
                write!(f, "all {all} replays failed; the first: {cause}")
            }
            Self::Unfinished(unfinished, all) => write!(
                f,
                "{unfinished} of {all} replays failed, see the table; the results of the others are written"
            ),
            Self::Output(cause) => cause.fmt(f),
            Self::Terms(cause) => f.write_str(cause),
        }
    }
}

impl From<RecordingError> for Failure {
    fn from(cause: RecordingError) -> Self {
        Self::Recording(cause)
    }
}

impl From<OutputError> for Failure {
    fn from(cause: OutputError) -> Self {
        Self::Output(cause)
    }
}
