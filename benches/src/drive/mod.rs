//! Runs one script in several modes side by side and records the results.
//!
//! All modes take the same tick in turn, so machine noise affects all alike.

mod app;
pub(crate) mod compare;
mod free;
pub mod player;
mod process;
mod remote;
mod side_by_side;

use std::fmt;

use rhumb_client::{ClientError, OpenError};
use rhumb_netsim::RelayError;
use rhumb_protocol::scene::{CommandError, Invalid};
use rhumb_reckoning::Tick;
use rhumb_scene::{HookError, SceneFault, StepThreadsError};

use crate::record::Mode;

pub use app::{AppError, Defect, Defects, Unsupported};
pub use free::run_free;
pub(crate) use process::{BesideListener, OwnProcess, Signal};
pub use process::{ProcessError, ScriptChoice, Serve, ServerCpu, ServerProcess, serve};
pub use side_by_side::{Cores, Plan, run_side_by_side};

/// The error of a run.
#[derive(Debug)]
pub enum DriveError {
    /// The server process did not start.
    Process(ProcessError),
    /// The client could not join its scene.
    Open(OpenError),
    /// A call on the client failed.
    Client(ClientError),
    /// A mode of the paper's protocol failed.
    App(AppError),
    /// The relay that simulates the link did not start.
    Relay(RelayError),
    /// The engine in this process failed.
    Scene(SceneFault),
    /// The requested number of threads is not available.
    StepThreads(StepThreadsError),
    /// The script's config is invalid.
    Config(Invalid),
    /// The scene refused a command of the script.
    Refused(CommandError),
    /// A command of the script's controller was refused.
    Controller(HookError),
    /// The server granted fewer body indices than the script needs.
    NotGranted,
    /// A lockstep copy lacks bodies, or shows a tick the engine never simulated.
    Incomplete {
        /// Mode of the copy.
        mode: Mode,
        /// Tick at which it was found.
        tick: Tick,
    },
    /// No scene has this name.
    NoSuchScene {
        /// The requested name.
        name: String,
    },
}

impl fmt::Display for DriveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Process(cause) => cause.fmt(f),
            Self::Open(cause) => cause.fmt(f),
            Self::Client(cause) => cause.fmt(f),
            Self::App(cause) => cause.fmt(f),
            Self::Relay(cause) => cause.fmt(f),
            Self::Scene(cause) => cause.fmt(f),
            Self::StepThreads(cause) => cause.fmt(f),
            Self::Config(cause) => cause.fmt(f),
            Self::Refused(cause) => write!(f, "the script's command was refused: {cause}"),
            Self::Controller(cause) => cause.fmt(f),
            Self::NotGranted => {
                f.write_str("the server granted fewer body indices than the script needs")
            }
            Self::Incomplete { mode, tick } => {
                write!(f, "the copy of {mode} lacks bodies of the scene at {tick}")
            }
            Self::NoSuchScene { name } => {
                write!(
                    f,
                    "there is no scene {name:?}; there are: {}",
                    rhumb_sims::NAMES.join(", ")
                )
            }
        }
    }
}

impl std::error::Error for DriveError {}

impl From<ProcessError> for DriveError {
    fn from(cause: ProcessError) -> Self {
        Self::Process(cause)
    }
}

impl From<OpenError> for DriveError {
    fn from(cause: OpenError) -> Self {
        Self::Open(cause)
    }
}

impl From<ClientError> for DriveError {
    fn from(cause: ClientError) -> Self {
        Self::Client(cause)
    }
}

impl From<AppError> for DriveError {
    fn from(cause: AppError) -> Self {
        Self::App(cause)
    }
}

impl From<RelayError> for DriveError {
    fn from(cause: RelayError) -> Self {
        Self::Relay(cause)
    }
}
