//! A server process keeps serving, whatever a scene or its log does.
//!
//! Every wait is for an event, with a time limit. Caught: 5,000 balls at one point stopped all scenes for 40 s and
//! SIGTERM for 10 s; a full disk under the log ended the process; a pipe without a reader stopped it.

use std::fs::OpenOptions;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use rhumb_client::scene::{BodyDesc, SceneConfig, Shape, Stepping};
use rhumb_client::{Client, ClientError, JoinMode, JoinOptions, PipelineDepth, Trust};
use rhumb_protocol::Ending;
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::Tick;
use rhumb_tests::ServerProcess;

use crate::SERVER;

/// Longer than any step of these tests, on a busy machine; reached only by a failure.
const LONG: Duration = Duration::from_secs(60);

fn join(server: &ServerProcess, scene: &str, stepping: Stepping) -> Client {
    let config = SceneConfig {
        stepping,
        ..SceneConfig::default()
    };
    let options = JoinOptions {
        mode: JoinMode::CreateOrJoin(config),
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect_within(&server.address.to_string(), trust, LONG);
    let joined = connection.and_then(|connection| connection.join_with(scene, options));
    joined.expect("the server is there")
}

/// Steps a scene so often.
fn advance(client: &mut Client, ticks: u64) {
    for _ in 0..ticks {
        client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    }
}

/// The answer to a request for a server's figures or health.
pub(crate) fn requested(metrics: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(metrics).expect("the server answers");
    stream
        .set_read_timeout(Some(LONG))
        .expect("a time limit is set");
    let request = format!("GET {path} HTTP/1.1\r\nHost: {metrics}\r\n\r\n");
    stream
        .write_all(request.as_bytes())
        .expect("the request leaves");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("an answer comes");
    answer
}

/// A configuration under which a crowd is stepped, whatever its step takes.
pub(crate) fn uncrowded(directory: &Path) -> String {
    let file = directory.join("uncrowded.toml");
    let text = "[limits]\nscene_crowding = 4294967295\n";
    std::fs::write(&file, text).expect("a temporary file");
    file.to_str().expect("text").to_owned()
}

/// An address with a port that is free now.
pub(crate) fn free_address() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    listener.local_addr().expect("it is bound").to_string()
}

#[test]
fn a_step_that_does_not_end_stops_neither_other_scenes_nor_figures_nor_sigterm() {
    let metrics = free_address();
    let directory = tempfile::tempdir().expect("a temporary directory");
    let flights = directory.path().join("flights");
    let flight = flights.to_str().expect("text");
    let config = uncrowded(directory.path());
    let more = [
        "--config",
        &config,
        "--metrics",
        &metrics,
        "--flight",
        flight,
    ];
    let server = SERVER.serve_with("127.0.0.1:0", &more);
    let mut victim = join(&server, "victim", Stepping::Lockstep);
    advance(&mut victim, 10);
    let mut attacker = join(&server, "attacked", Stepping::FreeRunning);
    let balls = (0..5_000).map(|_| BodyDesc::dynamic(Shape::ball(0.5)));
    attacker.add_bodies(balls).expect("they are bodies");
    attacker.flush();
    let until = Instant::now() + LONG;
    let ended = loop {
        advance(&mut victim, 1);
        if let Err(error) = attacker.idle(Duration::from_millis(1)) {
            break error;
        }
        assert!(Instant::now() < until, "the scene was not quarantined");
    };
    let quarantined = Ending::Closed(CloseCode::SCENE_QUARANTINED.0);
    assert!(
        matches!(ended, ClientError::Ended(ending) if ending == quarantined),
        "{ended}"
    );
    let mut joiner = join(&server, "another", Stepping::Lockstep);
    advance(&mut joiner, 10);
    assert!(requested(&metrics, "/health").starts_with("HTTP/1.1 200 OK"));
    assert!(requested(&metrics, "/other").starts_with("HTTP/1.1 404"));
    let figures = requested(&metrics, "/metrics");
    for line in [
        "rhumb_scenes_quarantined 1",
        "rhumb_closed_total{code=\"6\"} 1",
        "rhumb_scene_tick{scene=\"another\"} 10",
        "rhumb_scene_members{scene=\"victim\"} 1",
    ] {
        assert!(
            figures.lines().any(|have| have == line),
            "{line} in\n{figures}"
        );
    }
    assert!(victim.advance(PipelineDepth::LOCKSTEP).expect("it steps") > Tick::new(10));
    server.signal("TERM");
    // A server that does not stop in time ends with another code.
    let ended = server.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    assert_flight_ends_in_a_step(&flights);
}

/// The flight recorder of the quarantined scene names the cause, the commands, and the step that did not end.
fn assert_flight_ends_in_a_step(flights: &Path) {
    let files: Vec<PathBuf> = std::fs::read_dir(flights)
        .expect("the server made the directory")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    let [file] = &files[..] else {
        panic!("not one file: {files:?}");
    };
    let printed = SERVER.run(&["flight", file.to_str().expect("text")]);
    assert_eq!(printed.code, Some(0), "{}", printed.log);
    let lines: Vec<&str> = printed.out.lines().collect();
    assert_eq!(lines[0], "scene attacked");
    assert_eq!(
        lines[1],
        "cause the scene did not answer and is quarantined"
    );
    assert!(lines.iter().any(|line| line.contains("AddBody")));
    let last_step = lines
        .iter()
        .rposition(|line| line.contains("step from tick"));
    let last_step = last_step.expect("a step began");
    assert!(
        !lines[last_step..]
            .iter()
            .any(|line| line.contains("  tick"))
    );
    // A file that was cut short is refused, and named.
    let whole = std::fs::read(file).expect("it is there");
    std::fs::write(file, &whole[..whole.len() / 2]).expect("it can be written");
    let refused = SERVER.run(&["flight", file.to_str().expect("text")]);
    assert_eq!(refused.code, Some(1));
    assert!(
        refused.log.contains("was cut short or changed"),
        "{}",
        refused.log
    );
}

#[test]
fn a_log_on_a_full_disk_or_in_an_unread_pipe_stops_nothing() {
    let full = OpenOptions::new().write(true).open("/dev/full");
    let full = full.expect("the system has a device that is always full");
    for log in [Stdio::from(full), Stdio::piped()] {
        let server = SERVER.serve_logging_to("127.0.0.1:0", log);
        let mut client = join(&server, "logged", Stepping::Lockstep);
        // At level trace each datagram is worth several lines: far more than a pipe holds.
        advance(&mut client, 500);
        server.signal("TERM");
        let ended = server.wait();
        assert_eq!(ended.code, Some(0));
    }
}
