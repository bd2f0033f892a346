//! A server process, and clients that join its scenes.

use std::io::{BufRead as _, BufReader};
use std::path::PathBuf;
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

use rhumb_client::scene::{SceneConfig, Stepping};
use rhumb_client::{
    Client, JoinMode, JoinOptions, PipelineDepth, ServerConnection, StreamChoice, Tick, Trust,
};

/// A server process, which ends when dropped.
pub(crate) struct Server {
    pub(crate) child: Child,
    pub(crate) address: String,
    pub(crate) fingerprint: String,
    /// Open, so that what the server prints has a reader.
    _out: BufReader<ChildStdout>,
}

impl Server {
    pub(crate) fn start() -> Self {
        Self::start_with(&[])
    }

    /// The same with more arguments.
    pub(crate) fn start_with(more: &[&str]) -> Self {
        let built =
            PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../target/debug/rhumb-test-server");
        let path = std::env::var_os("RHUMB_TEST_SERVER").map_or(built, PathBuf::from);
        let mut child = Command::new(&path)
            .args(["--open", "--listen", "127.0.0.1:0", "--log", "off"])
            .args(more)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| {
                panic!(
                    "the server {} does not start: {error}. Build it with `cargo build -p rhumb-tests --bin \
                     rhumb-test-server` in the main workspace, or name one in RHUMB_TEST_SERVER",
                    path.display()
                )
            });
        let mut out = BufReader::new(child.stdout.take().expect("standard output is piped"));
        let (mut address, mut fingerprint) = (None, None);
        while address.is_none() || fingerprint.is_none() {
            let mut line = String::new();
            let read = out.read_line(&mut line).expect("the output is text");
            assert!(
                read > 0,
                "the server ended before it printed its address and its fingerprint"
            );
            let line = line.trim_end();
            address = address.or(line.strip_prefix("listening on ").map(str::to_owned));
            fingerprint = fingerprint.or(line.strip_prefix("fingerprint ").map(str::to_owned));
        }
        Self {
            child,
            address: address.expect("read above"),
            fingerprint: fingerprint.expect("read above"),
            _out: out,
        }
    }

    pub(crate) fn connect(&self) -> ServerConnection {
        let fingerprint = self.fingerprint.parse().expect("a fingerprint");
        Client::connect(&self.address, Trust::Fingerprint(fingerprint)).expect("the server answers")
    }

    /// Joins a scene, which is created with this stepping unless it exists.
    pub(crate) fn join(&self, scene: &str, stepping: Stepping, stream: StreamChoice) -> Client {
        let config = SceneConfig {
            stepping,
            ..SceneConfig::default()
        };
        let options = JoinOptions {
            mode: JoinMode::CreateOrJoin(config),
            stream,
            whole_ticks: true,
            smooth: false,
            ..JoinOptions::default()
        };
        self.connect()
            .join_with(scene, options)
            .expect("the scene is joined")
    }

    /// Ends the process at once, as a crash would.
    pub(crate) fn kill(&mut self) {
        self.child.kill().expect("the process is ours");
        self.child.wait().expect("the process has ended");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It may have ended already.
        let _ended = self.child.kill();
        let _ended = self.child.wait();
    }
}

/// Lets the client of the truth show a tick.
pub(crate) fn show_tick(truth: &mut Client, tick: Tick) {
    while truth.statistics().complete < tick {
        truth
            .idle(Duration::from_millis(1))
            .expect("the server continues");
    }
    let shown = truth
        .wait(PipelineDepth::LOCKSTEP)
        .expect("the server continues");
    assert_eq!(shown, tick, "the truth is at the tick of the copy");
}

/// Steps a lockstep scene until a tick that another member has not shown yet: it has this member's queued commands in it.
/// A tick that the other has requested already may have been computed before they came.
pub(crate) fn advance_beyond(member: &mut Client, shown: Tick) {
    let mut tick = Tick::ZERO;
    while tick <= shown {
        tick = member
            .advance(PipelineDepth::LOCKSTEP)
            .expect("the server continues");
    }
}
