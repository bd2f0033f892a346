//! The `rhumb-paper` binary: repeats the paper's experiment and extends it.
//!
//! Tasks: the experiment itself, where remote beats integrated, hardware variants, and pages filled from the
//! measurements.

mod analysis;
mod document;
mod experiment;
mod gap;
mod hardware;
mod page;
mod processor;
mod remote;
mod settings;
mod tables;
mod trial;

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Parser, Subcommand};
use rhumb_bench::drive::{Serve, serve};

use document::PageArguments;
use experiment::ExperimentArguments;
use gap::GapArguments;
use hardware::HardwareArguments;
use processor::{DutyArguments, serve_duty};
use remote::RemoteArguments;

/// Repeats the paper's experiment, or runs one of the tasks beside it.
#[derive(Debug, Parser)]
#[command(
    name = "rhumb-paper",
    version,
    about,
    args_conflicts_with_subcommands = true
)]
struct Arguments {
    #[command(subcommand)]
    task: Option<Task>,
    #[command(flatten)]
    experiment: ExperimentArguments,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Find the load and the amount of other work from which a remote engine beats an integrated one.
    Remote(RemoteArguments),
    /// Find where the client of the published experiment loses its time.
    Gap(GapArguments),
    /// Measure one pit with various threads, pinnings and caller speeds on this machine.
    Hardware(HardwareArguments),
    /// Merge the results of several machines into one table.
    Merge(MergeArguments),
    /// Write measurements into a page between its markers, or check that the page is current.
    Page(PageArguments),
    /// Stop and continue the parent process in turn.
    #[command(hide = true)]
    Duty(DutyArguments),
    /// Run a server: how the other tasks start theirs.
    #[command(hide = true)]
    Serve(Box<Serve>),
}

/// Arguments: the files and the folder of the merged results.
#[derive(Clone, Debug, Args)]
struct MergeArguments {
    /// `hardware.json` of each machine.
    #[arg(required = true, num_args = 1..)]
    files: Vec<PathBuf>,
    /// Folder for the merged table; created if missing.
    #[arg(long, default_value = "results/hardware-merged")]
    out: PathBuf,
}

fn main() -> ExitCode {
    let arguments: Arguments = rhumb_server::cli::parse();
    let done = match arguments.task {
        None => experiment::run(&arguments.experiment),
        Some(Task::Remote(arguments)) => remote::run(&arguments),
        Some(Task::Gap(arguments)) => gap::run(&arguments),
        Some(Task::Hardware(arguments)) => hardware::run(&arguments),
        Some(Task::Merge(arguments)) => hardware::merge(&arguments.files, &arguments.out),
        Some(Task::Page(arguments)) => document::run(&arguments),
        Some(Task::Duty(arguments)) => return serve_duty(&arguments),
        Some(Task::Serve(arguments)) => return serve(*arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}
