//! A server in a process of its own.
//!
//! This binary is also a server (hidden subcommand `serve`), so that nothing else needs to be built or found.

use std::fmt;
use std::io::{self, BufRead, BufReader};
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::process::{Child, Command, Stdio};

use rhumb_transport::Fingerprint;

use super::control::ScriptChoice;

/// A running server, killed when dropped.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    /// Where it listens.
    pub address: SocketAddr,
    /// What to pin.
    pub fingerprint: Fingerprint,
    /// Where clients of the paper's protocol are awaited, if they are.
    pub app: Option<SocketAddr>,
}

/// Where a server runs, and on how many threads it steps.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ServerCpu {
    /// The cores it keeps to; any if empty.
    pub cores: Vec<usize>,
    /// Threads of the engine; one unless said.
    pub threads: Option<NonZeroU32>,
}

impl ServerCpu {
    /// One thread, on one core if asked.
    #[must_use]
    pub fn on(core: Option<usize>) -> Self {
        Self {
            cores: core.into_iter().collect(),
            threads: None,
        }
    }
}

/// Why there is no server.
#[derive(Debug)]
pub enum ProcessError {
    /// The process cannot be started.
    Start(io::Error),
    /// It ended, or said something else, before it said where it listens.
    NoAddress {
        /// What it said.
        said: String,
    },
}

impl fmt::Display for ProcessError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Start(cause) => write!(f, "cannot start the server process: {cause}"),
            Self::NoAddress { said } => {
                write!(
                    f,
                    "the server process did not say where it listens; it said {said:?}"
                )
            }
        }
    }
}

impl std::error::Error for ProcessError {}

impl ServerProcess {
    /// Starts a server on a free port of loopback, on its cores, beside the controller of a script if named.
    ///
    /// # Errors
    ///
    /// [`ProcessError`] when it does not start or does not say where it is.
    pub fn start(
        cpu: &ServerCpu,
        controller_script: Option<&ScriptChoice>,
    ) -> Result<Self, ProcessError> {
        Self::start_with(cpu, controller_script, &[])
    }

    /// The same with more arguments, such as where clients of the paper's protocol are awaited.
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
        command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn"]);
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
}

/// What the start-up lines name.
type Addresses = (SocketAddr, Fingerprint, Option<SocketAddr>);

/// Reads the lines that name address and fingerprint, and the address for the paper's protocol if there is one.
fn read_start_up_lines(child: &mut Child, awaits_app: bool) -> Result<Addresses, ProcessError> {
    let (mut said, mut address, mut fingerprint) = (String::new(), None, None);
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
            said.push_str(&line);
            said.push('\n');
            if let (Some(address), Some(fingerprint)) = (address, fingerprint)
                && app.is_some() == awaits_app
            {
                return Ok((address, fingerprint, app));
            }
        }
    }
    Err(ProcessError::NoAddress { said })
}

/// A process that is gone already needs no ending.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        end(&mut self.child);
    }
}
