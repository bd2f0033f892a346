//! Runs a server in a process of its own.
//!
//! Mostly, the server is this binary with the hidden subcommand `serve`, so no other program must be built or found.

use std::fmt;
use std::io::{self, BufRead, BufReader};
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::process::{Child, Command, Stdio};

use rhumb_transport::Fingerprint;

use super::control::ScriptChoice;

/// A running server; killed on drop.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    /// Address on which the server listens.
    pub address: SocketAddr,
    /// Fingerprint of its certificate, for pinning.
    pub fingerprint: Fingerprint,
    /// Address for clients of the paper's protocol, if enabled.
    pub app: Option<SocketAddr>,
}

/// Cores and threads of a server.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServerCpu {
    /// Cores the server is pinned to; empty means any.
    pub cores: Vec<usize>,
    /// Threads of the engine; `None` means one.
    pub threads: Option<NonZeroU32>,
}

impl ServerCpu {
    /// One thread, on the given core if any.
    #[must_use]
    pub fn on(core: Option<usize>) -> Self {
        Self {
            cores: core.into_iter().collect(),
            threads: None,
        }
    }
}

/// The error of a server that did not start.
#[derive(Debug)]
pub enum ProcessError {
    /// The process cannot be started.
    Start(io::Error),
    /// The server ended, or printed something else, before it printed its address.
    NoAddress {
        /// Its output.
        output: String,
    },
}

impl fmt::Display for ProcessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start(cause) => write!(f, "cannot start the server process: {cause}"),
            Self::NoAddress { output } => {
                write!(
                    f,
                    "the server process did not print its address; its output was {output:?}"
                )
            }
        }
    }
}

impl std::error::Error for ProcessError {}

impl ServerProcess {
    /// Starts a server on a free port of loopback, on its cores, with the controller of a script if given.
    ///
    /// # Errors
    ///
    /// [`ProcessError`] if it does not start or does not print its address.
    pub fn start(
        cpu: &ServerCpu,
        controller_script: Option<&ScriptChoice>,
    ) -> Result<Self, ProcessError> {
        Self::start_with(cpu, controller_script, &[])
    }

    /// The same with more arguments, such as the address for the paper's protocol.
    ///
    /// # Errors
    ///
    /// As [`Self::start`].
    pub fn start_with(
        cpu: &ServerCpu,
        controller_script: Option<&ScriptChoice>,
        more: &[&str],
    ) -> Result<Self, ProcessError> {
        let program = std::env::current_exe().map_err(ProcessError::Start)?;
        let mut command = Command::new(program);
        command.args([
            "serve",
            "--open",
            "--listen",
            "127.0.0.1:0",
            "--log",
            "warn",
        ]);
        if !cpu.cores.is_empty() {
            let cores: Vec<_> = cpu.cores.iter().map(usize::to_string).collect();
            command.arg("--core").arg(cores.join(","));
        }
        if let Some(threads) = cpu.threads {
            command.arg("--threads").arg(threads.to_string());
        }
        if let Some(played) = controller_script {
            command.args(["--scene", &played.scene]);
            command.args(["--bodies", &played.bodies.to_string()]);
            command.args(["--seed", &played.seed.to_string()]);
        }
        command.args(more);
        let awaits_app = more.iter().any(|more| more.starts_with("--app-listen"));
        Self::run(&mut command, awaits_app)
    }

    /// Starts a server by a command, and waits until it listens.
    ///
    /// # Errors
    ///
    /// As [`Self::start`]; then no process is left.
    pub(crate) fn run(command: &mut Command, awaits_app: bool) -> Result<Self, ProcessError> {
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(ProcessError::Start)?;
        match read_start_up_lines(&mut child, awaits_app) {
            Ok((address, fingerprint, app)) => Ok(Self {
                child,
                address,
                fingerprint,
                app,
            }),
            Err(error) => {
                end(&mut child);
                Err(error)
            }
        }
    }

    /// Its process id.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }
}

/// Contents of the start-up lines.
type Addresses = (SocketAddr, Fingerprint, Option<SocketAddr>);

/// Reads the start-up lines: address, fingerprint and, if expected, the address for the paper's protocol.
fn read_start_up_lines(child: &mut Child, awaits_app: bool) -> Result<Addresses, ProcessError> {
    let (mut output, mut address, mut fingerprint) = (String::new(), None, None);
    let mut app = None;
    if let Some(out) = child.stdout.take() {
        for line in BufReader::new(out).lines() {
            let line = line.map_err(ProcessError::Start)?;
            if let Some(text) = line.strip_prefix("listening on ") {
                address = text.parse().ok();
            }
            if let Some(text) = line.strip_prefix("fingerprint ") {
                fingerprint = text.parse().ok();
            }
            if let Some(text) = line.strip_prefix("app listening on ") {
                app = text.parse().ok();
            }
            output.push_str(&line);
            output.push('\n');
            if let (Some(address), Some(fingerprint)) = (address, fingerprint)
                && app.is_some() == awaits_app
            {
                return Ok((address, fingerprint, app));
            }
        }
    }
    Err(ProcessError::NoAddress { output })
}

/// Kills the process; one that has already ended needs nothing.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        end(&mut self.child);
    }
}
