//! The Rust client as one under test, for `rhumb-conformance client`.
//!
//! `--mutant NAME` makes it break one promise on purpose, for trying the suite itself. Exit code 127: it has not what it is
//! ordered to do.

use std::io::{self, Write};
use std::process::ExitCode;

use clap::Parser;
use rhumb_tests::conformance::mutants::ClientMutant;
use rhumb_tests::testee::{Honest, TesteeOrders, run};

/// Follows a scene as its environment orders, and tells what it holds.
#[derive(Debug, Parser)]
struct Arguments {
    /// The promise that it breaks.
    #[arg(long, value_enum)]
    mutant: Option<ClientMutant>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let orders = match TesteeOrders::from_environment() {
        Ok(orders) => orders,
        Err(None) => return ExitCode::from(127),
        Err(Some(why)) => return fail(&why),
    };
    let done = match arguments.mutant {
        None => run(&orders, &mut Honest),
        Some(mutant) => run(&orders, mutant.habit().as_mut()),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => fail(&why.to_string()),
    }
}

fn fail(why: &str) -> ExitCode {
    // Nowhere is left to say that this failed.
    let _ = writeln!(io::stderr(), "error: {why}");
    ExitCode::FAILURE
}
