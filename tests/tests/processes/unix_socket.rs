//! A server process with a Unix socket, and clients on both ways.

use std::io::{BufRead, BufReader, Lines};
use std::process::{self, Child, ChildStdout, Stdio};

use rhumb_client::scene::{BodyDesc, Command, Shape};
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, OpenError, PipelineDepth, Tick, Trust,
};
use rhumb_tests::signal;

use crate::SERVER;

#[test]
fn a_unix_socket_reaches_the_same_scenes() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("rhumb.sock");
    let path = path.to_str().expect("text");
    let server = SERVER.serve_with("127.0.0.1:0", &["--socket", path]);
    let address = format!("unix:{path}");
    let fingerprint = server.fingerprint;
    let trust = || Trust::Fingerprint(fingerprint);
    let mut near = Client::connect(&address, trust())
        .and_then(|connection| connection.join("near"))
        .expect("the server is there");
    let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
    near.add_body(floor).expect("room for a body");
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
    let ball = near.add_body(ball).expect("room for a body");
    for _ in 0..180 {
        near.advance(PipelineDepth::LOCKSTEP)
            .expect("the scene continues");
    }
    let far = Client::connect(&server.address.to_string(), trust())
        .and_then(|connection| connection.join("near"))
        .expect("the server is there");
    let height = |client: &Client| client.view().position(ball).expect("a body").y;
    assert!((height(&near) - 0.5).abs() < 0.1);
    assert!((height(&far) - height(&near)).abs() < 0.1);
    drop(server);
    let ended = near.advance(PipelineDepth::LOCKSTEP);
    assert!(matches!(ended, Err(ClientError::Ended(_))), "{ended:?}");
    let refused = Client::connect(&address, trust()).err();
    assert!(
        matches!(refused, Some(OpenError::Socket { .. })),
        "{refused:?}"
    );
}

/// Ticks for which a program is stopped: 100 s at 60 Hz.
const STOPPED: u64 = 6_000;

/// A program that steps a scene, and the ticks that it has written.
struct Stepping {
    child: Child,
    lines: Lines<BufReader<ChildStdout>>,
}

impl Stepping {
    fn begin(address: &str, fingerprint: &str, scene: &str) -> Self {
        let mut child = process::Command::new(env!("CARGO_BIN_EXE_rhumb-step"))
            .args([address, fingerprint, scene])
            .stdout(Stdio::piped())
            .spawn()
            .expect("running a program");
        let lines = BufReader::new(child.stdout.take().expect("it is piped")).lines();
        Self { child, lines }
    }

    /// The next tick, and the bound of its ball in metres.
    fn next(&mut self) -> (u64, f64) {
        let line = self.lines.next().expect("it continues").expect("text");
        let (tick, bound) = line.split_once(' ').expect("two numbers");
        let bound = bound.parse().expect("a number");
        (tick.parse().expect("a number"), bound)
    }
}

impl Drop for Stepping {
    fn drop(&mut self) {
        self.child.kill().expect("it can be ended");
        self.child.wait().expect("waiting for a child process");
    }
}

#[test]
fn a_program_that_was_stopped_for_100_seconds_of_ticks_comes_back_to_the_present() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("rhumb.sock");
    let path = path.to_str().expect("text");
    let server = SERVER.serve_with("127.0.0.1:0", &["--socket", path]);
    let address = format!("unix:{path}");
    let mut stopped = Stepping::begin(&address, &server.fingerprint.to_string(), "stopped");
    let (first, _) = stopped.next();
    signal(stopped.child.id(), "STOP");
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let leader = Client::connect(&address, Trust::Fingerprint(server.fingerprint));
    let leader = leader.and_then(|connection| connection.join_with("stopped", options));
    let mut leader = leader.expect("the scene is there");
    let mut present = Tick::ZERO;
    while present.value() < first + STOPPED {
        // Scene events wait for the stopped member, beside the datagrams that are superseded.
        let ball = BodyDesc::dynamic(Shape::ball(0.2)).at(3.0, 2.0, 0.0);
        let ball = leader.add_body(ball).expect("room for a body");
        present = (leader.advance(PipelineDepth::LOCKSTEP)).expect("the scene continues");
        let removed = leader.command(Command::RemoveBody { id: ball });
        removed.expect("a member may");
    }
    let present = leader.inspect().expect("an answer").tick.value();
    signal(stopped.child.id(), "CONT");
    // It had written some ticks before it was stopped. Each of its calls asks for one tick more than the call before, and
    // shows the newest one that has come, so that it is back before it has asked for all that it missed.
    let mut calls: u64 = 1;
    let mut last = first;
    while last < present {
        let (tick, bound) = stopped.next();
        assert!(
            tick >= last && bound.is_finite(),
            "{tick} after {last}, {bound} m"
        );
        (last, calls) = (tick, calls + 1);
        assert!(
            calls <= present,
            "at tick {last} of {present} after {calls} calls"
        );
    }
    println!("back at tick {last} after {calls} calls");
    // From then on it steps the scene as before.
    while last < present + 100 {
        last = stopped.next().0;
    }
    let (next, bound) = stopped.next();
    assert_eq!(next, last + 1);
    // The ball has fallen for 50 km, where 32 bits are 3.9 mm apart.
    assert!((0.05..0.052).contains(&bound), "{bound}");
}
