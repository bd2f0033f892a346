//! The server's command line, as a binary that this package's tests can find.

use std::process::ExitCode;

use clap::Parser;
use rhumb_server::cli::{Arguments, main as serve};

fn main() -> ExitCode {
    serve(Arguments::parse())
}
