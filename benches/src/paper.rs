//! `rhumb-bench paper`: repeats the paper's experiment and extends it.
//!
//! Tasks: the experiment itself, where remote beats integrated, hardware variants, and pages filled from the
//! measurements.

mod analysis;
mod beside;
mod cores;
mod crossover;
mod document;
mod duty;
mod engines;
mod error;
mod experiment;
mod figures;
mod findings;
mod gap;
mod hardware;
mod loads;
mod outcome;
mod page;
mod pit;
mod published;
mod quota;
mod remote;
mod report;
mod results;
mod settings;
mod statistics;
mod store;
mod table;
mod tables;
mod tolerance;
mod trial;

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};

use document::PageArguments;
use duty::DutyArguments;
use experiment::ExperimentArguments;
use gap::GapArguments;
use hardware::HardwareArguments;
use remote::RemoteArguments;

/// Arguments: the paper's experiment, or one of the tasks beside it.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true)]
pub struct Paper {
    #[command(subcommand)]
    task: Option<PaperTask>,
    #[command(flatten)]
    experiment: ExperimentArguments,
}

#[derive(Clone, Debug, Subcommand)]
enum PaperTask {
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

/// Runs a task of the paper. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn paper(arguments: &Paper) -> ExitCode {
    let done = match &arguments.task {
        None => experiment::run(&arguments.experiment),
        Some(PaperTask::Remote(arguments)) => remote::run(arguments),
        Some(PaperTask::Gap(arguments)) => gap::run(arguments),
        Some(PaperTask::Hardware(arguments)) => hardware::run(arguments),
        Some(PaperTask::Merge(arguments)) => hardware::merge(&arguments.files, &arguments.out),
        Some(PaperTask::Page(arguments)) => document::run(arguments),
        Some(PaperTask::Duty(arguments)) => return duty::serve(arguments),
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
