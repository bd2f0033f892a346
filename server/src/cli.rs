//! Command line of `rhumb-server`, reusable by other binaries.
//!
//! Start-up lines go to standard output, one fact a line, for readers and scripts; the log goes to standard error.

use std::error::Error;
use std::io::Write;
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use clap::{Parser, Subcommand};
use rhumb_protocol::Span;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::SceneName;
use rhumb_transport::Stop;
use tracing::level_filters::LevelFilter;

use crate::access::{DEFAULT_AUDIENCE, TokenKeys};
use crate::durable::{self, DataDir};
use crate::engine::Workers;
use crate::hook::Hooks;
use crate::log;
use crate::serve::{Access, Identity, RunError, Server, run_on_cores, seconds_since_1970};
use crate::token_command::{self, TokenArguments};

/// A Rapier server for remote rigid-body physics.
#[derive(Debug, Parser)]
#[command(
    name = "rhumb-server",
    version,
    about,
    args_conflicts_with_subcommands = true
)]
pub struct Arguments {
    #[command(subcommand)]
    task: Option<Task>,
    /// UDP address to listen on; port 0 picks a free one.
    #[arg(long, default_value = "127.0.0.1:4433")]
    listen: SocketAddr,
    /// PEM file with the certificate chain; without it a development certificate is made at start.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// PEM file with the certificate's private key.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
    /// File with a public key of tokens; may be repeated. `rhumb-server token --new-key FILE` makes keys.
    #[arg(long, value_name = "FILE", conflicts_with = "open")]
    token_key: Vec<PathBuf>,
    /// Name that a token must give as its audience.
    #[arg(long, default_value = DEFAULT_AUDIENCE)]
    audience: String,
    /// Admits every client of this machine without a token, for development.
    #[arg(long)]
    open: bool,
    /// Lets clients without a token come from other machines too: those of --open and of --app-listen.
    #[arg(long)]
    open_to_network: bool,
    /// Log level: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info")]
    log: LevelFilter,
    /// Run on this processor core alone, or on these cores.
    #[arg(long, value_delimiter = ',')]
    core: Vec<usize>,
    /// Number of threads to step on, shared by all scenes; more than one needs the feature `parallel`.
    #[arg(long, default_value = "1")]
    threads: NonZeroU32,
    /// Largest packet of a stream, bytes, from 700 to 1150. Relays and browsers add headers of their own.
    #[arg(long, value_name = "BYTES", default_value_t)]
    largest_packet: LargestPacket,
    /// Seconds after which a scene without members ends; 0 keeps it until a client deletes it.
    #[arg(long, default_value_t = 600)]
    empty_scene_seconds: u32,
    /// Directory for command logs and snapshots, from which scenes are restored at start; without it, scenes end with
    /// the process.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    #[cfg(feature = "app")]
    #[command(flatten)]
    app: crate::app_arguments::AppArguments,
}

/// Tasks beside serving.
#[derive(Debug, Subcommand)]
enum Task {
    /// Makes a token for a client, or the keys for tokens.
    Token(TokenArguments),
    /// Verifies every scene of a data directory that no server uses: authentic, whole, and replayed to the same bits.
    Check {
        /// The directory.
        dir: PathBuf,
    },
    /// Runs the log of a scene again from the oldest state that is kept.
    Replay {
        /// The directory.
        dir: PathBuf,
        /// The scene.
        scene: SceneName,
    },
}

/// A server that has not stopped so long after a signal is ended: two seconds are promised.
const STOP_WITHIN: Duration = Duration::from_millis(1_500);

/// What an operator reads who has not decided about access.
const NO_ACCESS: &str = "no client could join: start with --open to admit all clients of this machine, \
    or make keys by `rhumb-server token --new-key FILE` and start with --token-key FILE.pub";

/// Exit code of a server that was ended so.
const EXIT_NOT_STOPPED: i32 = 3;

/// Runs a server until SIGINT or SIGTERM. Exit code 0 after such a stop, 1 when it cannot start or fails, 3 when it
/// does not stop in time.
pub fn main(arguments: Arguments) -> ExitCode {
    main_with(arguments, None)
}

/// As [`main`], with hooks for the scenes that clients create.
pub fn main_with(arguments: Arguments, hooks: Option<Hooks>) -> ExitCode {
    let outcome = match arguments.task {
        Some(Task::Token(token)) => token_command::run(token, seconds_since_1970()),
        Some(Task::Check { dir }) => durable::check(&dir, &mut std::io::stdout()),
        Some(Task::Replay { dir, scene }) => {
            durable::replay(&dir, &scene, &mut std::io::stdout())
        }
        None => {
            let _last_lines = log::start(arguments.log);
            run(arguments, hooks)
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The cause of a failed start is printed at any log level. If standard error fails too, nothing is left to
            // try.
            let _ = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: Arguments, hooks: Option<Hooks>) -> Result<(), Box<dyn Error>> {
    if !arguments.core.is_empty() {
        run_on_cores(&arguments.core)?;
    }
    let workers = Workers::new(Some(arguments.threads)).map_err(RunError::Workers)?;
    let access = access(&arguments)?;
    let identity = match (arguments.cert, arguments.key) {
        (Some(certificate), Some(key)) => Identity::Files { certificate, key },
        _ => Identity::Development,
    };
    #[cfg(feature = "app")]
    if !arguments.open_to_network
        && let Some(address) = arguments.app.beyond_loopback()
    {
        return Err(RunError::OpenToNetwork(address).into());
    }
    let stop = Stop::new();
    let mut server = Server::bind(arguments.listen, &identity, access)?;
    server.employ(workers);
    server.set_largest_packet(arguments.largest_packet);
    if arguments.empty_scene_seconds > 0 {
        let milliseconds = u64::from(arguments.empty_scene_seconds) * 1_000;
        server.expire_empty_scenes(Span::from_millis(milliseconds));
    }
    if let Some(dir) = &arguments.data {
        server.store_in(DataDir::open(dir)?);
    }
    if let Some(hooks) = hooks {
        server.attach(hooks);
    }
    #[cfg(feature = "app")]
    let app = arguments.app.listen(&mut server)?;
    #[cfg(not(feature = "app"))]
    let app = None;
    let running = Arc::new(AtomicBool::new(true));
    let (requested, still_running) = (stop.clone(), Arc::clone(&running));
    let on_signal = move || {
        requested.stop();
        thread::sleep(STOP_WITHIN);
        if still_running.load(Ordering::Relaxed) {
            tracing::error!("the server did not stop in time");
            std::process::exit(EXIT_NOT_STOPPED);
        }
    };
    // Fails only when a handler is installed already: its owner decides when to stop.
    if let Err(cause) = ctrlc::set_handler(on_signal) {
        tracing::warn!("signals do not stop this server: {cause}");
    }
    announce(&server, &identity, app);
    let outcome = server.run(&stop);
    running.store(false, Ordering::Relaxed);
    let statistics = outcome?;
    tracing::info!(connections = statistics.opened, "stopped");
    Ok(())
}

/// The clients to admit. Nobody is admitted without a token unless the operator says so.
fn access(arguments: &Arguments) -> Result<Access, Box<dyn Error>> {
    if arguments.open {
        return Ok(if arguments.open_to_network {
            Access::OpenToNetwork
        } else {
            Access::OpenOnLoopback
        });
    }
    if arguments.token_key.is_empty() {
        return Err(NO_ACCESS.into());
    }
    let keys = TokenKeys::read(&arguments.token_key, &arguments.audience)?;
    Ok(Access::Tokens(keys))
}

/// Prints the address and the fingerprint to pin. A closed standard output does not stop a server.
fn announce(server: &Server, identity: &Identity, app: Option<SocketAddr>) {
    let kind = match identity {
        Identity::Development => "development, made at start",
        Identity::Files { .. } => "from files",
    };
    let app = app.map_or_else(String::new, |app| format!("app listening on {app}\n"));
    let lines = format!(
        "rhumb-server {}\nlistening on {}\ncertificate {kind}\nfingerprint {}\n{app}",
        env!("CARGO_PKG_VERSION"),
        server.address(),
        server.fingerprint(),
    );
    let mut out = std::io::stdout().lock();
    if let Err(cause) = out.write_all(lines.as_bytes()).and_then(|()| out.flush()) {
        tracing::warn!("cannot write the start-up lines: {cause}");
    }
}
