//! `rhumb-bench load`: servers under load, as a service is judged.
//!
//! Plain, it runs many scenes and members over minutes. Its subcommands measure a frame by where the physics is, the
//! cost of a server's settings, and what an abused scene does to its neighbour.

mod frames;
mod neighbour;
mod rig;
mod scenes;
mod service;

use std::process::ExitCode;

use clap::{Args, Subcommand};

use crate::task::ended;

pub use frames::Frames;
pub use neighbour::Neighbour;
pub use scenes::Load;
pub use service::ServiceCosts;

/// Arguments: those of many scenes, or another measurement.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct LoadArguments {
    #[command(subcommand)]
    other: Option<OtherLoad>,
    #[command(flatten)]
    scenes: scenes::ScenesArguments,
}

#[derive(Clone, Debug, Subcommand)]
enum OtherLoad {
    /// Measure a simulator's frame with its physics in process, in another process and behind a socket.
    Frames(frames::FramesArguments),
    /// Measure what tokens, durability and worker processes of a server cost.
    Service(service::ServiceArguments),
    /// Measure a scene's frames while another scene of the server is abused.
    Neighbour(neighbour::NeighbourArguments),
}

/// Runs a measurement. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn load(arguments: &LoadArguments) -> ExitCode {
    ended(match &arguments.other {
        None => scenes::run(&arguments.scenes),
        Some(OtherLoad::Frames(arguments)) => frames::run(arguments),
        Some(OtherLoad::Service(arguments)) => service::run(arguments),
        Some(OtherLoad::Neighbour(arguments)) => neighbour::run(arguments),
    })
}
