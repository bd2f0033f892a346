//! The Rust client as the client under test of `rhumb-conformance client`.
//!
//! `--mutant NAME` makes it break one promise on purpose, to test the suite itself. Exit code 127 means that the task
//! is unsupported.

use std::io::{self, Write};
use std::process::ExitCode;

use clap::Parser;
use rhumb_conformance::mutants::ClientMutant;
use rhumb_conformance::testee::{Honest, TesteeEnvironment, run};

/// Subscribes to a scene as its environment says, and reports the state of its copy.
#[derive(Debug, Parser)]
struct Arguments {
    /// The promise to break.
    #[arg(long, value_enum)]
    mutant: Option<ClientMutant>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let environment = match TesteeEnvironment::from_environment() {
        Ok(environment) => environment,
        Err(None) => return ExitCode::from(127),
        Err(Some(why)) => return fail(&why),
    };
    let done = match arguments.mutant {
        None => run(&environment, &mut Honest),
        Some(mutant) => run(&environment, mutant.behaviour().as_mut()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => fail(&why.to_string()),
    }
}

fn fail(why: &str) -> ExitCode {
    // Standard error is closed too: there is no other place for the message.
    let _ = writeln!(io::stderr(), "error: {why}");
    ExitCode::FAILURE
}
