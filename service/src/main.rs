//! The `rhumb-server` binary.

use std::process::ExitCode;

use rhumb_server::cli::{main as serve, parse};

fn main() -> ExitCode {
    serve(parse())
}
