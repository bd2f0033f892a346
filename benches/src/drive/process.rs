//! A server in a process of its own.
//!
//! This binary is also a server (hidden subcommand `serve`), so that nothing else needs to be built or found.

use std::fmt;
use std::io::{self, BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, Command, Stdio};

use rhumb_transport::Fingerprint;

use super::control::Played;

/// A running server, killed when dropped.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    /// Where it listens.
    pub address: SocketAddr,
    /// What to pin.
    pub fingerprint: Fingerprint,
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
    /// Starts a server on a free port of loopback, on one core if asked, beside the controller of a script if named.
    ///
    /// # Errors
    ///
    /// [`ProcessError`] when it does not start or does not say where it is.
    pub fn start(core: Option<usize>, beside: Option<&Played>) -> Result<Self, ProcessError> {
        let program = std::env::current_exe().map_err(ProcessError::Start)?;
        let mut command = Command::new(program);
        command.args(["serve", "--listen", "127.0.0.1:0", "--log", "warn"]);
        if let Some(core) = core {
            command.arg("--core").arg(core.to_string());
        }
        if let Some(played) = beside {
            command.args(["--scene", &played.scene]);
            command.args(["--bodies", &played.bodies.to_string()]);
            command.args(["--seed", &played.seed.to_string()]);
        }
        let mut child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(ProcessError::Start)?;
        match read_start_up_lines(&mut child) {
            Ok((address, fingerprint)) => Ok(Self {
                child,
                address,
                fingerprint,
            }),
            Err(error) => {
                end(&mut child);
                Err(error)
            }
        }
    }
}

/// Reads the lines that name address and fingerprint.
fn read_start_up_lines(child: &mut Child) -> Result<(SocketAddr, Fingerprint), ProcessError> {
    let (mut said, mut address, mut fingerprint) = (String::new(), None, None);
    if let Some(out) = child.stdout.take() {
        for line in BufReader::new(out).lines() {
            let line = line.map_err(ProcessError::Start)?;
            if let Some(text) = line.strip_prefix("listening on ") {
                address = text.parse().ok();
            }
            if let Some(text) = line.strip_prefix("fingerprint ") {
                fingerprint = text.parse().ok();
            }
            said.push_str(&line);
            said.push('\n');
            if let (Some(address), Some(fingerprint)) = (address, fingerprint) {
                return Ok((address, fingerprint));
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
