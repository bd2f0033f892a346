//! Runs a server in a process of its own, with a script's controller.
//!
//! Mostly, the server is this binary with the hidden subcommand `serve`, so no other program must be built or found. A
//! script's controller is a hook of the scene, here and in the server process.

use std::io::{BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::{Duration, Instant};
use std::{fmt, io, thread};

use clap::Args;
use rhumb_scene::{Hook, Hooks, Scene};
use rhumb_server::{RunError, run_on_cores};
use rhumb_sims::{Controller, Script};
use rhumb_transport::Fingerprint;

use crate::scripts;

/// A running program; ended in order on drop, and killed if it does not end.
#[derive(Debug)]
pub(crate) struct OwnProcess(Child);

/// A running server, ended as every program that is started here.
#[derive(Debug)]
pub struct ServerProcess {
    process: OwnProcess,
    /// Address on which the server listens.
    pub address: SocketAddr,
    /// Fingerprint of its certificate, for pinning.
    pub fingerprint: Fingerprint,
    /// Address of the listener beside its own that was awaited.
    pub beside: Option<SocketAddr>,
}

/// A listener beside the server's own, whose line is awaited at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum BesideListener {
    /// The listener for clients of the paper's protocol.
    App,
    /// The listener for metrics.
    Metrics,
}

impl BesideListener {
    /// The address in a start-up line, if the line is this listener's.
    fn address(self, line: &str) -> Option<SocketAddr> {
        let address = match self {
            Self::App => line.strip_prefix("app listening on ")?,
            Self::Metrics => line
                .strip_prefix("metrics at http://")?
                .strip_suffix("/metrics")?,
        };
        address.parse().ok()
    }
}

/// A signal to a server's process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Signal {
    /// Ends it at once, as a crash does.
    Kill,
    /// Freezes it.
    Stop,
    /// It continues.
    Continue,
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
        let has_app = more.iter().any(|more| more.starts_with("--app-listen"));
        Self::run(&mut command, has_app.then_some(BesideListener::App))
    }

    /// Starts a server by a command, and waits until it listens.
    ///
    /// # Errors
    ///
    /// As [`Self::start`]; then no process is left.
    pub(crate) fn run(
        command: &mut Command,
        awaited: Option<BesideListener>,
    ) -> Result<Self, ProcessError> {
        let (mut address, mut fingerprint, mut beside) = (None, None, None);
        let (process, (address, fingerprint)) = OwnProcess::run(command, |line| {
            if let Some(text) = line.strip_prefix("listening on ") {
                address = text.parse().ok();
            }
            if let Some(text) = line.strip_prefix("fingerprint ") {
                fingerprint = text.parse().ok();
            }
            beside = beside.or_else(|| awaited?.address(line));
            let is_there = beside.is_some() == awaited.is_some();
            address.zip(fingerprint).filter(|_| is_there)
        })?;
        Ok(Self {
            process,
            address,
            fingerprint,
            beside,
        })
    }

    /// As [`Self::run`]; the server may use some cores only, or all if none is named.
    ///
    /// # Errors
    ///
    /// As [`Self::start`], and where the system refuses the cores.
    pub(crate) fn run_on(
        cores: &[usize],
        command: &mut Command,
        awaited: Option<BesideListener>,
    ) -> Result<Self, ProcessError> {
        // A process inherits the cores of the thread that starts it.
        let started = thread::scope(|scope| {
            let bound = scope.spawn(|| {
                if !cores.is_empty() {
                    let refused = |cause: RunError| ProcessError::Start(io::Error::other(cause));
                    run_on_cores(cores).map_err(refused)?;
                }
                Self::run(command, awaited)
            });
            bound.join()
        });
        started.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }

    /// Sends a signal.
    ///
    /// # Errors
    ///
    /// As [`OwnProcess::send`].
    pub(crate) fn send(&self, signal: Signal) -> io::Result<()> {
        self.process.send(signal)
    }

    /// Its process id.
    pub(crate) fn id(&self) -> u32 {
        self.process.id()
    }

    /// True once it has ended by itself.
    pub(crate) fn has_ended(&mut self) -> bool {
        matches!(self.process.0.try_wait(), Ok(Some(_)))
    }

    /// Ends it at once, as a crash does, and waits until its address is free.
    ///
    /// # Errors
    ///
    /// The system refuses the signal.
    pub(crate) fn kill(&mut self) -> io::Result<()> {
        self.process.0.kill()?;
        self.process.0.wait().map(drop)
    }
}

impl OwnProcess {
    /// Starts a program by a command, and reads its lines until one has what is asked for.
    ///
    /// # Errors
    ///
    /// [`ProcessError`] if it does not start, or ends before; then no process is left.
    pub(crate) fn run<T>(
        command: &mut Command,
        mut read: impl FnMut(&str) -> Option<T>,
    ) -> Result<(Self, T), ProcessError> {
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(ProcessError::Start)?;
        let mut process = Self(child);
        let mut output = String::new();
        if let Some(out) = process.0.stdout.take() {
            for line in BufReader::new(out).lines() {
                let line = line.map_err(ProcessError::Start)?;
                if let Some(found) = read(&line) {
                    return Ok((process, found));
                }
                output.push_str(&line);
                output.push('\n');
            }
        }
        Err(ProcessError::NoAddress { output })
    }

    /// Sends a signal.
    ///
    /// # Errors
    ///
    /// The system refuses it, or has none.
    #[cfg(target_os = "linux")]
    pub(crate) fn send(&self, signal: Signal) -> io::Result<()> {
        use rustix::process::{Pid, Signal as Sent, kill_process};
        let sent = match signal {
            Signal::Kill => Sent::KILL,
            Signal::Stop => Sent::STOP,
            Signal::Continue => Sent::CONT,
        };
        let id = i32::try_from(self.0.id()).ok().and_then(Pid::from_raw);
        Ok(kill_process(id.ok_or(io::ErrorKind::NotFound)?, sent)?)
    }

    /// Sends a signal.
    ///
    /// # Errors
    ///
    /// This system has none.
    #[cfg(not(target_os = "linux"))]
    pub(crate) fn send(&self, _: Signal) -> io::Result<()> {
        Err(io::ErrorKind::Unsupported.into())
    }

    /// Its process id.
    pub(crate) fn id(&self) -> u32 {
        self.0.id()
    }
}

/// Longest time in which a server ends by itself: it takes two seconds at most.
const END_MAX: Duration = Duration::from_secs(5);
/// Pause between two looks at a server that ends.
const LOOK: Duration = Duration::from_millis(5);

/// Ends the process: by a signal, so that its files are whole, and if that does not help by force. One that has already
/// ended needs nothing.
fn end(child: &mut Child) {
    if ask_to_end(child) {
        let begun = Instant::now();
        while begun.elapsed() < END_MAX {
            match child.try_wait() {
                Ok(None) => thread::sleep(LOOK),
                _ => return,
            }
        }
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// Sends SIGTERM; false where that is not possible.
#[cfg(target_os = "linux")]
fn ask_to_end(child: &Child) -> bool {
    use rustix::process::{Pid, Signal, kill_process};
    let id = i32::try_from(child.id()).ok().and_then(Pid::from_raw);
    id.is_some_and(|id| kill_process(id, Signal::TERM).is_ok())
}

/// Sends SIGTERM; false where that is not possible.
#[cfg(not(target_os = "linux"))]
fn ask_to_end(_: &Child) -> bool {
    false
}

impl Drop for OwnProcess {
    fn drop(&mut self) {
        end(&mut self.0);
    }
}

/// Identifies a script and so its controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptChoice {
    /// Name of the script.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u32,
    /// Seed of the script.
    pub seed: u64,
}

impl ScriptChoice {
    /// Builds the script; `None` if the name is unknown.
    #[must_use]
    pub fn script(&self) -> Option<Box<dyn Script>> {
        scripts::by_name(&self.scene, self.bodies, self.seed)
    }
}

impl fmt::Display for ScriptChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} of {} bodies, seed {}",
            self.scene, self.bodies, self.seed
        )
    }
}

/// Wraps a controller as a scene hook.
pub(super) fn hook(mut controller: Box<dyn Controller>) -> Hook {
    Hook::new(move |scene: &Scene, out| {
        let motion = |id| scene.observation(id).map(|observation| observation.motion);
        controller.before_step(scene.tick(), &motion, out);
    })
}

/// Arguments of a server whose scenes run the controller of a script.
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    server: rhumb_server::cli::Arguments,
    /// Script whose controller acts in the scenes; none by default.
    #[arg(long, requires_all = ["bodies", "seed"])]
    scene: Option<String>,
    /// Number of bodies of the script.
    #[arg(long)]
    bodies: Option<u32>,
    /// Seed of the script.
    #[arg(long)]
    seed: Option<u64>,
}

/// Runs a server until it is stopped. Exit code 1 if it cannot start or the script is unknown.
pub fn serve(arguments: Serve) -> ExitCode {
    end_with_parent();
    let Serve {
        server,
        scene,
        bodies,
        seed,
    } = arguments;
    let (Some(scene), Some(bodies), Some(seed)) = (scene, bodies, seed) else {
        return rhumb_server::cli::main(server);
    };
    let script_choice = ScriptChoice {
        scene,
        bodies,
        seed,
    };
    let Some(script) = script_choice.script() else {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "error: no such script: {script_choice}");
        return ExitCode::FAILURE;
    };
    let hooks = Hooks::new(move |_, _| script.controller().map(hook));
    rhumb_server::cli::main_with(server, Some(hooks))
}

/// Ends this process when its parent ends, for any reason.
#[cfg(target_os = "linux")]
fn end_with_parent() {
    use rustix::process::{Signal, set_parent_process_death_signal};
    // If the system refuses, the server outlives a killed parent, as on other systems.
    let _ = set_parent_process_death_signal(Some(Signal::TERM));
}

/// Not available on this system: the process outlives its parent.
#[cfg(not(target_os = "linux"))]
fn end_with_parent() {}

/// Longest silence of a server before a run fails. An engine may take over half a minute for the first frame of a
/// hundred thousand bodies. A server that ends is noticed at once, because its connection closes.
pub(super) const SERVER_TIMEOUT: Duration = Duration::from_secs(300);
