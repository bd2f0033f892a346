//! The `rhumb-bench` binary: what Rhumb costs, beside its alternatives.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use rhumb_bench::evaluate::{Evaluate, evaluate};

/// Measures Rhumb.
#[derive(Debug, Parser)]
#[command(name = "rhumb-bench", version, about)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Run a scene in process, naively remote and over Rhumb; write table, trace and report.
    Evaluate(Evaluate),
    /// Be a server: how the other tasks start theirs.
    #[command(hide = true)]
    Serve(rhumb_server::cli::Arguments),
}

fn main() -> ExitCode {
    match Arguments::parse().task {
        Task::Evaluate(arguments) => evaluate(&arguments),
        Task::Serve(arguments) => rhumb_server::cli::main(arguments),
    }
}
