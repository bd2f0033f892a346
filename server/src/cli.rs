//! The command line of `rhumb-server`, so that another binary can be one too.
//!
//! Start-up lines go to standard output, one fact a line, for people and scripts; the log goes to standard error.

use std::io::{IsTerminal, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::Parser;
use rhumb_transport::Stop;
use tracing::level_filters::LevelFilter;

use crate::hook::Hooks;
use crate::serve::{Identity, RunError, Server, run_on_core};

/// A Rapier server for remote rigid-body physics.
#[derive(Debug, Parser)]
#[command(name = "rhumb-server", version, about)]
pub struct Arguments {
    /// UDP address to listen on; port 0 picks a free one.
    #[arg(long, default_value = "127.0.0.1:4433")]
    listen: SocketAddr,
    /// PEM file with the certificate chain; without it a development certificate is made at start.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// PEM file with the certificate's private key.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
    /// What to log: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info")]
    log: LevelFilter,
    /// Run on this processor core alone.
    #[arg(long)]
    core: Option<usize>,
}

/// Runs a server until SIGINT or SIGTERM. Exit code 0 after such a stop, 1 when it cannot start or breaks.
pub fn main(arguments: Arguments) -> ExitCode {
    main_with(arguments, None)
}

/// As [`main`], with hooks for the scenes that clients create.
pub fn main_with(arguments: Arguments, hooks: Option<Hooks>) -> ExitCode {
    tracing_subscriber::fmt()
        .with_max_level(arguments.log)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .with_target(false)
        .init();
    match run(arguments, hooks) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Whatever is logged, what keeps a server from starting is said. Nowhere is left to say that this failed.
            let _ = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments, hooks: Option<Hooks>) -> Result<(), RunError> {
    if let Some(core) = arguments.core {
        run_on_core(core)?;
    }
    let identity = match (arguments.cert, arguments.key) {
        (Some(certificate), Some(key)) => Identity::Files { certificate, key },
        _ => Identity::Development,
    };
    let stop = Stop::new();
    let mut server = Server::bind(arguments.listen, &identity)?;
    if let Some(hooks) = hooks {
        server.attach(hooks);
    }
    let asked = stop.clone();
    // Fails only when a handler stands already: then whoever set it up decides when to stop.
    if let Err(cause) = ctrlc::set_handler(move || asked.stop()) {
        tracing::warn!("signals do not stop this server: {cause}");
    }
    announce(&server, &identity);
    let statistics = server.run(&stop)?;
    tracing::info!(connections = statistics.opened, "stopped");
    Ok(())
}

/// Tells where the server is and what to pin. A closed standard output does not stop a server.
fn announce(server: &Server, identity: &Identity) {
    let kind = match identity {
        Identity::Development => "development, made at start",
        Identity::Files { .. } => "from files",
    };
    let lines = format!(
        "rhumb-server {}\nlistening on {}\ncertificate {kind}\nfingerprint {}\n",
        env!("CARGO_PKG_VERSION"),
        server.address(),
        server.fingerprint(),
    );
    let mut out = std::io::stdout().lock();
    if let Err(cause) = out.write_all(lines.as_bytes()).and_then(|()| out.flush()) {
        tracing::warn!("cannot write the start-up lines: {cause}");
    }
}
