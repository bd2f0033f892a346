//! Why a task on a recording did not come to its end.

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use super::session::ReplayError;
use crate::output::OutputError;
use crate::recording::RecordingError;

/// Why a task on a recording did not come to its end.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The recording cannot be read.
    Recording(RecordingError),
    /// None of so many replays ended; why the first did not.
    Replay(usize, ReplayError),
    /// So many of so many replays did not end; of all others everything is written.
    Unfinished(usize, usize),
    /// Something cannot be written.
    Output(OutputError),
    /// What was asked for is not possible, in words.
    Terms(String),
}

/// Exit code 0 for what was done and written; otherwise 1, and the reason on standard error.
pub(crate) fn ended(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // Nowhere is left to say that standard error is closed.
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
                write!(f, "none of {all} replays ended; the first: {cause}")
            }
            Self::Unfinished(unfinished, all) => write!(
                f,
                "{unfinished} of {all} replays did not end, as the table says; of the others everything is written"
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
