//! The server, the script and the frame times of a load.

use std::path::PathBuf;
use std::process::Command as Program;
use std::time::Duration;

use clap::Args;
use rhumb_client::Client;
use rhumb_protocol::scene::Command;
use rhumb_sims::{Script, by_name};
use serde::{Deserialize, Serialize};

use crate::drive::{BesideListener, ServerProcess};
use crate::numbers;
use crate::output::Failure;

/// The server that is measured.
#[derive(Clone, Debug, Args)]
pub(super) struct ServerArguments {
    /// The server's program [default: rhumb-server beside this program].
    #[arg(long, value_name = "FILE")]
    server: Option<PathBuf>,
    /// Cores that the server may use [default: all].
    #[arg(long, value_name = "CORES", value_delimiter = ',')]
    server_cores: Vec<usize>,
    /// Further flags of the server, after `--`.
    #[arg(last = true)]
    flags: Vec<String>,
}

impl ServerArguments {
    /// A command of the server's program, without arguments.
    pub(super) fn program(&self) -> Result<Program, Failure> {
        Ok(Program::new(match &self.server {
            Some(program) => program.clone(),
            None => std::env::current_exe()?.with_file_name("rhumb-server"),
        }))
    }

    /// Starts the server on a free port of loopback, and waits until it listens.
    pub(super) fn start(
        &self,
        more: &[&str],
        awaited: Option<BesideListener>,
    ) -> Result<ServerProcess, Failure> {
        let mut command = self.program()?;
        command.args(["--listen", "127.0.0.1:0"]).args(more);
        command.args(&self.flags);
        let cores = &self.server_cores;
        Ok(ServerProcess::run_on(cores, &mut command, awaited)?)
    }
}

/// The script of this name.
pub(super) fn script(name: &str, bodies: u32, seed: u64) -> Result<Box<dyn Script>, Failure> {
    Ok(by_name(name, bodies, seed).ok_or_else(|| format!("no scene has the name {name}"))?)
}

/// Takes the ids that these commands of a script give to their bodies.
pub(super) fn take_ids(client: &mut Client, commands: &[Command]) -> Result<(), Failure> {
    let bodies = |command: &&Command| matches!(command, Command::AddBody { .. });
    let count = commands.iter().filter(bodies).count();
    if count > 0 {
        client.new_ids(u32::try_from(count)?)?;
    }
    Ok(())
}

/// Times of frames, microseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameTimes {
    /// The median.
    pub p50_us: f64,
    /// The 99th percentile.
    pub p99_us: f64,
    /// The greatest.
    pub max_us: f64,
}

impl FrameTimes {
    pub(super) fn of(frames: &[Duration]) -> Self {
        let nanoseconds = |frame: &Duration| u64::try_from(frame.as_nanos()).unwrap_or(u64::MAX);
        let mut frames: Vec<u64> = frames.iter().map(nanoseconds).collect();
        let mut percentile = |percent| {
            let ns = numbers::of_nanoseconds(&mut frames, percent);
            ns.map_or(0.0, |ns| ns as f64 * 1e-3)
        };
        Self {
            p50_us: percentile(50),
            p99_us: percentile(99),
            max_us: percentile(100),
        }
    }
}
