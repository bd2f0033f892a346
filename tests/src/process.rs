//! A server process, as an operator would run it.
//!
//! The binary is this package's copy of `rhumb-server`: two lines around the same `cli::main`. Cargo passes the path
//! of a binary to tests of the same package only.

use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, ChildStdout, Command, Stdio};

use rhumb_transport::Fingerprint;

/// The path of the binary.
#[derive(Clone, Copy, Debug)]
pub struct Programme(pub &'static str);

/// The result of a process that has ended.
#[derive(Clone, Debug)]
pub struct Ended {
    /// Its exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Its standard output.
    pub out: String,
    /// Its standard error.
    pub log: String,
}

/// A running server, killed when dropped.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    out: BufReader<ChildStdout>,
    /// Its start-up lines.
    pub lines: Vec<String>,
    /// The address that it listens on.
    pub address: SocketAddr,
    /// The fingerprint to pin.
    pub fingerprint: Fingerprint,
    /// The address for clients of the paper's protocol, if enabled.
    pub app: Option<SocketAddr>,
}

impl Programme {
    /// Runs the binary with invalid arguments, until it ends.
    #[must_use]
    pub fn run(self, arguments: &[&str]) -> Ended {
        Self::ended(self.spawn(arguments))
    }

    /// The same with a variable of the environment.
    #[must_use]
    pub fn run_with_variable(self, variable: (&str, &str), arguments: &[&str]) -> Ended {
        Self::ended(self.spawn_in(Some(variable), arguments, Stdio::piped()))
    }

    fn ended(child: Child) -> Ended {
        let output = child
            .wait_with_output()
            .expect("waiting for a child process");
        Ended {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            log: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Shows the demo on free ports of loopback.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn demo(self, more: &[&str]) -> ServerProcess {
        let plain = ["demo", "--view", "127.0.0.1:0", "--no-browser"];
        let child = self.spawn(&[&plain, more].concat());
        Self::started(child, START_UP_LINES + 1)
    }

    /// Starts an edge of a server, without a log unless it has metrics, and reads its start-up lines.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn edge(self, owner: &ServerProcess, listen: &str, more: &[&str]) -> ServerProcess {
        let (owner, print) = (owner.address.to_string(), owner.fingerprint.to_string());
        let plain = [
            "edge",
            "--owner",
            &owner,
            "--fingerprint",
            &print,
            "--listen",
        ];
        let child = self.spawn(&[&plain[..], &[listen, "--log", "warn"], more].concat());
        Self::started(child, START_UP_LINES)
    }

    /// Starts a server or an edge by exactly these arguments, and reads its start-up lines.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn start(self, arguments: &[&str]) -> ServerProcess {
        Self::started(self.spawn(arguments), START_UP_LINES)
    }

    /// Starts a server and reads its start-up lines.
    ///
    /// # Panics
    ///
    /// When the lines contain no address or no fingerprint.
    #[must_use]
    pub fn serve(self, listen: &str) -> ServerProcess {
        self.serve_with(listen, &[])
    }

    /// The same with everything logged, and standard error where the caller has it.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn serve_logging_to(self, listen: &str, log: Stdio) -> ServerProcess {
        let child = self.spawn_with(&["--open", "--listen", listen, "--log", "trace"], log);
        Self::started(child, START_UP_LINES)
    }

    /// The same without a log: no test reads the log while the server runs, and a full pipe would block it.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn serve_without_log(self, listen: &str) -> ServerProcess {
        self.serve_logging(listen, "off", &[])
    }

    /// The same, also for clients of the paper's protocol on a free port of loopback, with more arguments.
    ///
    /// # Panics
    ///
    /// When the lines contain no address.
    #[must_use]
    pub fn serve_app(self, listen: &str, more: &[&str]) -> ServerProcess {
        let app = ["--app-listen", "127.0.0.1:0"];
        self.serve_with(listen, &[&app, more].concat())
    }

    /// The same with more arguments. A server without `--token-key` is open.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn serve_with(self, listen: &str, more: &[&str]) -> ServerProcess {
        self.serve_logging(listen, "info", more)
    }

    /// Starts an open server with a variable of the environment, and reads its start-up lines.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn serve_with_variable(self, variable: (&str, &str), more: &[&str]) -> ServerProcess {
        let arguments = [&["--open", "--log", "info"], more].concat();
        let child = self.spawn_in(Some(variable), &arguments, Stdio::piped());
        Self::started(child, START_UP_LINES)
    }

    fn serve_logging(self, listen: &str, log: &str, more: &[&str]) -> ServerProcess {
        let access = if more.contains(&"--token-key") {
            &[][..]
        } else {
            &["--open"]
        };
        let plain = ["--listen", listen, "--log", log];
        let child = self.spawn(&[access, &plain, more].concat());
        let listeners = ["--app-listen", "--foxglove", "--metrics", "--view"];
        let listeners = listeners.iter().filter(|flag| more.contains(flag));
        let expected = START_UP_LINES + listeners.count();
        Self::started(child, expected)
    }

    /// Reads the start-up lines of a server.
    fn started(mut child: Child, expected: usize) -> ServerProcess {
        let mut out = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let mut lines = Vec::new();
        while lines.len() < expected {
            let mut line = String::new();
            let read = out.read_line(&mut line).expect("the output is text");
            assert!(read > 0, "the server ended after it wrote {lines:?}");
            lines.push(line.trim_end().to_owned());
        }
        let after = |start: &str| {
            let line = lines.iter().find_map(|line| line.strip_prefix(start));
            line.unwrap_or_else(|| panic!("no line begins with {start:?} in {lines:?}"))
        };
        let address = after("listening on ")
            .parse()
            .expect("the line contains an address");
        let fingerprint = after("fingerprint ")
            .parse()
            .expect("the line contains a fingerprint");
        let app = lines
            .iter()
            .find_map(|line| line.strip_prefix("app listening on "))
            .map(|address| address.parse().expect("the line contains an address"));
        ServerProcess {
            app,
            child,
            out,
            lines,
            address,
            fingerprint,
        }
    }

    fn spawn(self, arguments: &[&str]) -> Child {
        self.spawn_with(arguments, Stdio::piped())
    }

    fn spawn_with(self, arguments: &[&str], log: Stdio) -> Child {
        self.spawn_in(None, arguments, log)
    }

    fn spawn_in(self, variable: Option<(&str, &str)>, arguments: &[&str], log: Stdio) -> Child {
        let mut command = Command::new(self.0);
        command.args(arguments).env("NO_COLOR", "1").envs(variable);
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(log);
        command.spawn().expect("running the binary of this package")
    }
}

/// Name and version, address, kind of certificate, fingerprint.
const START_UP_LINES: usize = 4;

impl ServerProcess {
    /// Its process id.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by name, `TERM` or `INT`.
    ///
    /// # Panics
    ///
    /// When the system has no `kill` command, or when it fails.
    pub fn signal(&self, name: &str) {
        signal(self.id(), name);
    }

    /// Ends the process at once, as a crash does.
    pub fn kill(self) {
        drop(self);
    }

    /// Waits until the process ends by itself.
    ///
    /// # Panics
    ///
    /// When waiting fails.
    #[must_use]
    pub fn wait(mut self) -> Ended {
        let (mut out, mut log) = (String::new(), String::new());
        self.out
            .read_to_string(&mut out)
            .expect("the output is text");
        if let Some(mut errors) = self.child.stderr.take() {
            errors.read_to_string(&mut log).expect("the log is text");
        }
        let status = self.child.wait().expect("waiting for a child process");
        Ended {
            code: status.code(),
            out,
            log,
        }
    }

    /// Processor time used so far, in clock ticks of 10 ms; `None` where the system does not provide it.
    #[must_use]
    pub fn processor_ticks(&self) -> Option<u64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.id())).ok()?;
        // The name in brackets may contain spaces; user and system time are the 12th and 13th field after it.
        let (_, fields) = stat.rsplit_once(')')?;
        let mut fields = fields.split_whitespace().skip(11);
        let (user, system): (u64, u64) =
            (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
        Some(user + system)
    }
}

/// Sends a signal to a process, by its name without `SIG`.
///
/// # Panics
///
/// When the system has no `kill` command, or when it fails.
pub fn signal(process: u32, name: &str) {
    let arguments = [format!("-{name}"), process.to_string()];
    let status = Command::new("kill").args(arguments).status();
    assert!(status.expect("running the kill command").success());
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        // Killing a process that has already ended does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
