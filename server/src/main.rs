//! The `rhumb-server` binary.

use std::process::ExitCode;

use clap::Parser;
use rhumb_server::cli::{Arguments, main as serve};

fn main() -> ExitCode {
    serve(Arguments::parse())
}
