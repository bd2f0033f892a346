//! `rhumb-server top --once` against a server process.
//!
//! The screen itself is tested in the server's crate, without a terminal.

use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{Client, PipelineDepth, Trust};
use rhumb_tests::ServerProcess;

use crate::SERVER;

const ANYWHERE: &str = "127.0.0.1:0";

/// The URL of a server's metrics.
fn metrics(server: &ServerProcess) -> &str {
    let line = server
        .lines
        .iter()
        .find_map(|line| line.strip_prefix("metrics at "));
    line.expect("a line names the metrics")
}

#[test]
fn a_table_shows_the_scenes_of_a_running_server() {
    let server = SERVER.serve_with(ANYWHERE, &["--metrics", ANYWHERE]);
    let trust = Trust::Fingerprint(server.fingerprint);
    let address = server.address.to_string();
    let connection = Client::connect(&address, trust).expect("the server listens");
    let mut client = connection.join("team/pit").expect("the scene begins");
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
    client.add_body(ball).expect("the body is added");
    for _ in 0..5 {
        client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    }
    let shown = SERVER.run(&["top", metrics(&server), "--once"]);
    assert_eq!(shown.code, Some(0), "{}", shown.log);
    let lines: Vec<_> = shown.out.lines().collect();
    assert!(
        lines[0].contains(": healthy, 1 connection, 1 so far, 1 scene, 0 quarantined"),
        "{}",
        shown.out
    );
    let titles: Vec<_> = lines[1].split_whitespace().collect();
    let cells: Vec<_> = lines[2].split_whitespace().collect();
    let cell = |title| {
        let at = titles.iter().position(|one| *one == title);
        cells[at.expect("the column is there")]
    };
    for (title, expected) in [
        ("SCENE", "team/pit"),
        ("CLIENTS", "1"),
        ("BODIES", "1"),
        ("AWAKE", "1"),
        ("TICK", "5"),
        ("TICKS/s", "0.0"),
        ("WAIT", "0"),
    ] {
        assert_eq!(cell(title), expected, "{title} in\n{}", shown.out);
    }
    assert!(cell("p50ms").parse::<f64>().is_ok(), "{}", shown.out);
    assert_eq!(lines.len(), 3, "{}", shown.out);
}

#[test]
fn a_server_that_does_not_answer_is_named_with_what_to_do() {
    let server = SERVER.serve_with(ANYWHERE, &["--metrics", ANYWHERE]);
    let url = metrics(&server).to_owned();
    drop(server);
    let shown = SERVER.run(&["top", &url, "--once"]);
    assert_eq!(shown.code, Some(1), "{}", shown.out);
    let expected = format!("error: cannot read {url}: cannot connect: ");
    assert!(shown.log.starts_with(&expected), "{}", shown.log);
    assert!(shown.log.contains("--metrics ADDRESS"), "{}", shown.log);
    let wrong = SERVER.run(&["top", "https://127.0.0.1:1", "--once"]);
    assert_eq!(wrong.code, Some(2), "{}", wrong.log);
    assert!(wrong.log.contains("https://127.0.0.1:1"), "{}", wrong.log);
}
