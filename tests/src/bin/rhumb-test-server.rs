//! The server's command line as a binary of this package, so that tests need not find or build another.

use std::process::ExitCode;

use clap::Parser;
use rhumb_server::cli::{Arguments, main as serve};

fn main() -> ExitCode {
    serve(Arguments::parse())
}
