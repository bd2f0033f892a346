//! A server in a process of its own, as an operator would run it.
//!
//! The binary is this package's twin of `rhumb-server`: two lines around the same `cli::main`. Cargo builds it for the
//! tests of any checkout and tells them where it is, which it does not for a binary of another package.

use std::io::{BufRead, BufReader, Read};
use std::net::SocketAddr;
use std::process::{Child, ChildStdout, Command, Stdio};

use rhumb_transport::Fingerprint;

/// Where the binary is.
#[derive(Clone, Copy, Debug)]
pub struct Programme(pub &'static str);

/// How a process ended.
#[derive(Clone, Debug)]
pub struct Ended {
    /// Its exit code; none when a signal ended it.
    pub code: Option<i32>,
    /// What it wrote to standard output.
    pub out: String,
    /// What it wrote to standard error.
    pub log: String,
}

/// A running server, killed when dropped.
#[derive(Debug)]
pub struct ServerProcess {
    child: Child,
    out: BufReader<ChildStdout>,
    /// Its start-up lines.
    pub lines: Vec<String>,
    /// Where it listens.
    pub address: SocketAddr,
    /// What to pin.
    pub fingerprint: Fingerprint,
    /// Where clients of the paper's protocol are awaited, if they are.
    pub app: Option<SocketAddr>,
}

impl Programme {
    /// Runs it with these arguments until it ends.
    #[must_use]
    pub fn run(self, arguments: &[&str]) -> Ended {
        let child = self.spawn(arguments);
        let output = child
            .wait_with_output()
            .expect("a child of ours can be waited for");
        Ended {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            log: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// Starts a server and reads its start-up lines.
    ///
    /// # Panics
    ///
    /// When it does not say where it listens and what to pin.
    #[must_use]
    pub fn serve(self, listen: &str) -> ServerProcess {
        self.serve_with(listen, &[])
    }

    /// The same without a log: nobody reads what a server says while it runs, and it waits once a pipe is full.
    ///
    /// # Panics
    ///
    /// As [`Self::serve`].
    #[must_use]
    pub fn serve_without_log(self, listen: &str) -> ServerProcess {
        self.serve_logging(listen, "off", &[])
    }

    /// The same for clients of the paper's protocol too, on a free port of loopback, with more arguments.
    ///
    /// # Panics
    ///
    /// When it does not say where it listens.
    #[must_use]
    pub fn serve_app(self, listen: &str, more: &[&str]) -> ServerProcess {
        let app = ["--app-listen", "127.0.0.1:0"];
        self.serve_with(listen, &[&app, more].concat())
    }

    fn serve_with(self, listen: &str, more: &[&str]) -> ServerProcess {
        self.serve_logging(listen, "info", more)
    }

    fn serve_logging(self, listen: &str, log: &str, more: &[&str]) -> ServerProcess {
        let plain = ["--listen", listen, "--log", log];
        let mut child = self.spawn(&[&plain, more].concat());
        let mut out = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let mut lines = Vec::new();
        let expected = START_UP_LINES + usize::from(more.contains(&"--app-listen"));
        while lines.len() < expected {
            let mut line = String::new();
            let read = out.read_line(&mut line).expect("the server says text");
            assert!(read > 0, "the server ended after it sent {lines:?}");
            lines.push(line.trim_end().to_owned());
        }
        let after = |start: &str| {
            let line = lines.iter().find_map(|line| line.strip_prefix(start));
            line.unwrap_or_else(|| panic!("no line begins with {start:?} in {lines:?}"))
        };
        let address = after("listening on ")
            .parse()
            .expect("it listens on an address");
        let fingerprint = after("fingerprint ")
            .parse()
            .expect("it shows a fingerprint");
        let app = lines
            .iter()
            .find_map(|line| line.strip_prefix("app listening on "))
            .map(|address| address.parse().expect("it listens on an address"));
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
        let mut command = Command::new(self.0);
        command.args(arguments).env("NO_COLOR", "1");
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
            .spawn()
            .expect("the binary of this package can be run")
    }
}

/// Name and version, address, kind of certificate, fingerprint.
const START_UP_LINES: usize = 4;

impl ServerProcess {
    /// Its process number.
    #[must_use]
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by name, `TERM` or `INT`.
    ///
    /// # Panics
    ///
    /// When the system has no such command, or it fails.
    pub fn signal(&self, name: &str) {
        let status = Command::new("kill")
            .arg(format!("-{name}"))
            .arg(self.id().to_string())
            .status();
        assert!(status.expect("the system has a kill command").success());
    }

    /// Waits until it has ended by itself.
    ///
    /// # Panics
    ///
    /// When the system does not tell.
    #[must_use]
    pub fn wait(mut self) -> Ended {
        let (mut out, mut log) = (String::new(), String::new());
        self.out
            .read_to_string(&mut out)
            .expect("the server says text");
        if let Some(mut errors) = self.child.stderr.take() {
            errors
                .read_to_string(&mut log)
                .expect("the server logs text");
        }
        let status = self
            .child
            .wait()
            .expect("a child of ours can be waited for");
        Ended {
            code: status.code(),
            out,
            log,
        }
    }

    /// Processor time that it used so far, in clock ticks of 10 ms; none where the system does not say.
    #[must_use]
    pub fn processor_ticks(&self) -> Option<u64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.id())).ok()?;
        // The name in brackets may hold anything; user and system time are the 12th and 13th field after it.
        let (_, fields) = stat.rsplit_once(')')?;
        let mut fields = fields.split_whitespace().skip(11);
        let (user, system): (u64, u64) =
            (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
        Some(user + system)
    }
}

impl Drop for ServerProcess {
    fn drop(&mut self) {
        // One that has ended already needs no ending.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
