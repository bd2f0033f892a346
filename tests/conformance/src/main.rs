//! The `rhumb-conformance` binary: tests implementations over a connection.

use std::process::ExitCode;

use rhumb_conformance::main as run;
use rhumb_server::cli::parse;

fn main() -> ExitCode {
    run(parse())
}
