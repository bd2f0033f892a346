//! The client under test, as a process.
//!
//! `docs/book/src/implementing.md` describes its environment and the lines that it writes. In short: its environment has
//! `RHUMB_ADDR`, `RHUMB_FINGERPRINT`, `RHUMB_SCENE`, `RHUMB_TASK`, `RHUMB_CASE`, `RHUMB_SEED`, `RHUMB_TOKEN` for a server
//! that asks for one, and it writes one JSON object per line. Exit code 127 means *unsupported*.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::Duration;

use rhumb_netsim::{RawConnection, RawPeerServer};
use rhumb_protocol::message::Token;
use rhumb_protocol::{Instant, Span};
use rhumb_transport::{Clock, Fingerprint};
use serde_json::Value;

use super::stderr_tail::StderrTail;
use crate::log::Log;
use crate::outcome::Stop;
use crate::testee::TesteeTask;

/// Exit code of a client that lacks the feature under test.
const UNSUPPORTED: i32 = 127;
/// Interval at which to check whether a client that does not connect has ended.
const LOOK: Duration = Duration::from_millis(50);

/// The environment of a client process.
#[derive(Debug)]
pub(super) struct ClientEnvironment<'a> {
    pub(super) server: SocketAddr,
    pub(super) fingerprint: Fingerprint,
    pub(super) scene: String,
    pub(super) task: &'a str,
    pub(super) case: &'a str,
    pub(super) seed: u64,
    pub(super) token: Option<&'a Token>,
}

/// The client's process. Dropping it kills the process and copies the tail of its standard error to the log.
#[derive(Debug)]
pub(super) struct ClientProcess {
    child: Child,
    /// The lines that the process writes.
    pub(super) lines: Receiver<String>,
    stderr_tail: Option<StderrTail>,
    log: Log,
    /// True if its task requires only what every client supports.
    is_plain: bool,
}

impl ClientProcess {
    pub(super) fn start(
        exec: &str,
        environment: &ClientEnvironment<'_>,
        log: Log,
    ) -> std::io::Result<Self> {
        let mut child = Command::new("sh")
            .args(["-c", &format!("exec {exec}")])
            .env("RHUMB_ADDR", environment.server.to_string())
            .env("RHUMB_FINGERPRINT", environment.fingerprint.to_string())
            .env("RHUMB_SCENE", &environment.scene)
            .env("RHUMB_TASK", environment.task)
            .env("RHUMB_CASE", environment.case)
            .env("RHUMB_SEED", environment.seed.to_string())
            .envs(
                environment
                    .token
                    .map(|token| ("RHUMB_TOKEN", token.as_str())),
            )
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        let (written, lines) = mpsc::channel();
        if let Some(out) = child.stdout.take() {
            thread::Builder::new().spawn(move || read_lines(out, &written))?;
        }
        let stderr_tail = child.stderr.take().map(StderrTail::of);
        Ok(Self {
            child,
            lines,
            stderr_tail,
            log,
            is_plain: matches!(
                TesteeTask::read(environment.task),
                Some(TesteeTask::Subscribe { .. })
            ),
        })
    }

    /// The stop that follows if the process has ended with the exit code for *unsupported*.
    ///
    /// Subscribing is mandatory, so a plain task fails then. A shell that does not find the command ends with that
    /// code too.
    pub(super) fn gave_up(&mut self) -> Option<Stop> {
        let ended = self.child.try_wait().ok().flatten();
        let says_so = ended.and_then(|status| status.code()) == Some(UNSUPPORTED);
        says_so.then(|| {
            if self.is_plain {
                Stop::Fail("its exit code declares even a plain subscription unsupported".into())
            } else {
                Stop::Unsupported("declared by the client's exit code".into())
            }
        })
    }

    pub(super) fn has_ended(&mut self) -> bool {
        self.child.try_wait().ok().flatten().is_some()
    }

    /// Waits for the client's connection.
    pub(super) fn connected(
        &mut self,
        server: &RawPeerServer,
        time_limit: Duration,
    ) -> Result<RawConnection, Stop> {
        let clock = Clock::start();
        let time_limit = Span::from_nanos(u64::try_from(time_limit.as_nanos()).unwrap_or(u64::MAX));
        let end = Instant::ZERO + time_limit;
        while clock.now() < end {
            if let Some(line) = server.accept(LOOK) {
                return line.map_err(|error| Stop::Fail(format!("no connection: {error}")));
            }
            if let Some(stop) = self.gave_up() {
                return Err(stop);
            }
            if self.has_ended() {
                break;
            }
        }
        Err(Stop::Inconclusive("the client did not connect".into()))
    }
}

fn read_lines(out: ChildStdout, written: &mpsc::Sender<String>) {
    for line in BufReader::new(out).lines().map_while(Result::ok) {
        if written.send(line).is_err() {
            return;
        }
    }
}

/// Parses a line that the client wrote.
///
/// # Errors
///
/// [`Stop::Fail`] when it is not a report.
pub(super) fn reported(line: &str) -> Result<Value, Stop> {
    let value: Value = serde_json::from_str(line)
        .map_err(|error| Stop::Fail(format!("a line of the client is not JSON: {error}")))?;
    if value["is"].is_string() {
        Ok(value)
    } else {
        Stop::fail("a line of the client has no field `is`")
    }
}

impl Drop for ClientProcess {
    fn drop(&mut self) {
        // Killing a process that has already ended does nothing.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let stderr_tail = self.stderr_tail.iter().flat_map(StderrTail::last);
        stderr_tail.for_each(|line| self.log.note(line));
    }
}
