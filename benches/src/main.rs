//! The `rhumb-bench` binary: measures the cost of Rhumb and its alternatives.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use rhumb_bench::ablate::{Ablate, ablate};
use rhumb_bench::cells::{CellArguments, cells};
use rhumb_bench::cost::{CostArguments, cost};
use rhumb_bench::dis::{DisArguments, dis};
use rhumb_bench::drive::{Serve, serve};
use rhumb_bench::evaluate::{Evaluate, evaluate};
use rhumb_bench::fit::{FitArguments, fit};
use rhumb_bench::import::{Check, Import, check, import};
use rhumb_bench::limit::{LimitArguments, limit};
use rhumb_bench::load::{LoadArguments, load};
use rhumb_bench::plan::{PlanArguments, plan};
use rhumb_bench::replay::{Replay, replay};
use rhumb_bench::scripts::{SceneArguments, scene};
use rhumb_server::cli::parse;

/// Command line of `rhumb-bench`.
#[derive(Debug, Parser)]
#[command(name = "rhumb-bench", version, about)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Run a scene in process, over naive replication and over Rhumb; write table, trace and report.
    Evaluate(Evaluate),
    /// Publish and subscribe to a recorded trace; write the same outputs.
    Replay(Replay),
    /// Measure the value and the price of each mechanism of the stream on standard loads.
    Ablate(Ablate),
    /// Measure the processor time of publishing, decoding and one more member.
    Cost(CostArguments),
    /// Measure members that take a scene by cells, beside one of the whole scene: bytes and server time.
    Cells(CellArguments),
    /// Say what a recording's poses and velocities tell of its engine, and warn of what does not fit.
    Check(Check),
    /// Read a recording of another program and write it as .rhtrace.
    Import(Import),
    /// Compare bytes and errors with those of DIS, on the same scenes.
    Dis(DisArguments),
    /// Run a server with many scenes and members over minutes; or measure frames, settings, neighbours.
    Load(LoadArguments),
    /// Compute the machines that a service of many scenes and members needs, and the limit that it reaches first.
    Plan(PlanArguments),
    /// Tasks for developers of Rhumb.
    #[command(subcommand, hide = true)]
    Dev(Dev),
    /// Run a server; the other tasks start theirs this way.
    #[command(hide = true)]
    Serve(Box<Serve>),
}

#[derive(Debug, Subcommand)]
enum Dev {
    /// Compute the fewest updates and bits a recorded trace needs if the future is known.
    Limit(LimitArguments),
    /// Fit the tables of the packet coder to recorded traces.
    Fit(FitArguments),
    /// Write the bodies a scene places as JSON, for engines that are not linked here.
    Scene(SceneArguments),
}

fn main() -> ExitCode {
    match parse::<Arguments>().task {
        Task::Evaluate(arguments) => evaluate(&arguments),
        Task::Replay(arguments) => replay(&arguments),
        Task::Ablate(arguments) => ablate(&arguments),
        Task::Cost(arguments) => cost(&arguments),
        Task::Cells(arguments) => cells(&arguments),
        Task::Check(arguments) => check(&arguments),
        Task::Import(arguments) => import(&arguments),
        Task::Dis(arguments) => dis(&arguments),
        Task::Load(arguments) => load(&arguments),
        Task::Plan(arguments) => plan(&arguments),
        Task::Dev(Dev::Limit(arguments)) => limit(&arguments),
        Task::Dev(Dev::Fit(arguments)) => fit(&arguments),
        Task::Dev(Dev::Scene(arguments)) => scene(&arguments),
        Task::Serve(arguments) => serve(*arguments),
    }
}
