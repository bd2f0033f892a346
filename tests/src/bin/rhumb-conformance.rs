//! The `rhumb-conformance` binary: tries implementations over the real wire.

use std::process::ExitCode;

use clap::Parser;
use rhumb_tests::conformance::{Arguments, main as run};

fn main() -> ExitCode {
    run(Arguments::parse())
}
