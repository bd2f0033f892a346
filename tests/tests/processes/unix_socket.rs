//! A server process with a Unix socket, and clients on both ways.

use std::io::{BufRead, BufReader};
use std::process::{self, Child, Stdio};

use rhumb_client::scene::{BodyDesc, Command, Shape};
use rhumb_client::{
    Client, ClientError, JoinMode, JoinOptions, OpenError, PipelineDepth, Tick, Trust,
};

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

fn signal(child: &Child, name: &str) {
    let (name, id) = (format!("-{name}"), child.id().to_string());
    let status = process::Command::new("kill").args([name, id]).status();
    assert!(status.expect("running the kill command").success());
}

/// The example of a falling ball, stopped with all of its threads in the middle of its 180 ticks, while another member leads
/// the scene on. Returns its last line; `None` if it had ended before it was stopped.
fn stop_and_go_on(address: &str, trust: &dyn Fn() -> Trust, fingerprint: &str) -> Option<String> {
    let mut child = process::Command::new(env!("CARGO_BIN_EXE_example-drop"))
        .args([address, fingerprint])
        .stdout(Stdio::piped())
        .spawn()
        .expect("running an example");
    let mut lines = BufReader::new(child.stdout.take().expect("it is piped")).lines();
    lines.next().expect("a first line").expect("text");
    signal(&child, "STOP");
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let leads =
        Client::connect(address, trust()).and_then(|server| server.join_with("drop", options));
    if let Ok(mut leader) = leads {
        let mut tick = Tick::ZERO;
        while tick.value() < STOPPED {
            // Scene events wait for the stopped member, beside the datagrams that are superseded.
            let ball = BodyDesc::dynamic(Shape::ball(0.2)).at(3.0, 2.0, 0.0);
            let ball = leader.add_body(ball).expect("room for a body");
            tick = (leader.advance(PipelineDepth::LOCKSTEP)).expect("the scene goes on");
            let removed = leader.command(Command::RemoveBody { id: ball });
            removed.expect("a member may");
        }
        leader
            .advance(PipelineDepth::LOCKSTEP)
            .expect("the scene goes on");
    }
    signal(&child, "CONT");
    let lines: Vec<_> = lines.map(|line| line.expect("text")).collect();
    let ended = child.wait().expect("waiting for a child process");
    assert!(ended.success(), "{ended}: {lines:?}");
    assert_eq!(lines.len(), 179);
    let last = lines.last().expect("many lines");
    (!last.starts_with("tick 180:")).then(|| last.clone())
}

#[test]
fn a_program_that_was_stopped_for_100_seconds_of_ticks_goes_on() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("rhumb.sock");
    let path = path.to_str().expect("text");
    let server = SERVER.serve_with("127.0.0.1:0", &["--socket", path]);
    let fingerprint = server.fingerprint;
    let trust = || Trust::Fingerprint(fingerprint);
    let address = format!("unix:{path}");
    let mut attempts =
        (0..20).filter_map(|_| stop_and_go_on(&address, &trust, &fingerprint.to_string()));
    let last = attempts.next().expect("it was stopped in time");
    // It is on its way through the ticks that it missed, as far as the machine lets it come, and knows how far off it is.
    let tick = last.trim_start_matches("tick ").split(':').next();
    let tick: u64 = tick.expect("a number").parse().expect("a number");
    assert!(tick > 180 && last.contains("Within"), "{last}");
}
