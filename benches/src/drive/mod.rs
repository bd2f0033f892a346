//! Runs one script in several modes side by side and records the results.
//!
//! All modes take the same tick in turn, so machine noise affects all alike.

mod app;
pub(crate) mod compare;
mod error;
mod free;
pub mod player;
mod process;
mod remote;
mod side_by_side;

pub use app::{AppError, Defect, Defects, Unsupported};
pub use error::DriveError;
pub use free::run_free;
pub(crate) use process::BesideListener;
pub use process::{ProcessError, ScriptChoice, Serve, ServerCpu, ServerProcess, serve};
pub use side_by_side::{Cores, Plan, run_side_by_side};
