//! The `rhumb-conformance` binary: tests implementations over a connection.

use std::process::ExitCode;

use clap::Parser;
use rhumb_conformance::{Arguments, main as run};

fn main() -> ExitCode {
    run(Arguments::parse())
}
