//! `rhumb-bench paper`: the paper's experiment again, and what it left open.
//!
//! The experiment itself, where remote wins, what hardware gives, and the page that tells it all from what was measured.

mod analysis;
mod beside;
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
mod pit;
mod published;
mod quota;
mod remote;
mod report;
mod settings;
mod statistics;
mod store;
mod table;
mod tables;
mod trial;

use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, Subcommand};

use document::PageArguments;
use duty::DutyArguments;
use error::PaperError;
use experiment::ExperimentArguments;
use gap::GapArguments;
use hardware::HardwareArguments;
use remote::RemoteArguments;

/// The paper's experiment, or one of the tasks beside it.
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
    /// From which load, and from how much other work on, a remote engine beats an integrated one.
    Remote(RemoteArguments),
    /// Where the client of the published experiment loses its time.
    Gap(GapArguments),
    /// What threads, pinning and a weak caller make of one pit, on this machine.
    Hardware(HardwareArguments),
    /// Merge what several machines gave into one table.
    Merge(MergeArguments),
    /// Put what was measured into a page between its markers, or check that it stands there.
    Page(PageArguments),
    /// Stop and continue the process that started this one, in turn.
    #[command(hide = true)]
    Duty(DutyArguments),
}

/// Which files, and where the merged ones go.
#[derive(Clone, Debug, Args)]
struct MergeArguments {
    /// `hardware.json` of each machine.
    #[arg(required = true, num_args = 1..)]
    files: Vec<PathBuf>,
    /// Folder for the merged table; made if it is not there.
    #[arg(long, default_value = "results/hardware-merged")]
    out: PathBuf,
}

/// Runs a task of the paper. Exit code 0 when everything was measured and written, 1 otherwise.
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
            // Nowhere is left to say that standard error is closed.
            let _ = writeln!(io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}
