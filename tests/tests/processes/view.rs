//! The page of a server process: how it connects, its relay, its token.
//!
//! The browser's part is tested by `viewer/test`. Here a client of the Rust library takes the page's ways.

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use rhumb_client::scene::{BodyDesc, BodyKind, CommandError, Shape};
use rhumb_client::{Client, Event, JoinOptions, Trust};
use rhumb_tests::ServerProcess;
use serde_json::Value;

use crate::SERVER;

const ANYWHERE: &str = "127.0.0.1:0";
/// Longer than any answer takes; reached only by a failure.
const LONG: Duration = Duration::from_secs(30);

/// False, with a line that says why, for a build without the page.
fn has_page() -> bool {
    let unavailable = rhumb_viewer::UNAVAILABLE;
    if let Some(reason) = unavailable {
        eprintln!("passed by: this build has no page: {reason}");
    }
    unavailable.is_none()
}

/// The address of a server's page.
fn page(server: &ServerProcess) -> String {
    let line = server
        .lines
        .iter()
        .find_map(|line| line.strip_prefix("page at http://"));
    line.expect("a line names the page")
        .trim_end_matches('/')
        .to_owned()
}

/// Head and body of the answer to a request.
fn request(page: &str, method: &str, path: &str, more: &str, body: &str) -> (String, Vec<u8>) {
    let mut stream = TcpStream::connect(page).expect("the page is served");
    stream.set_read_timeout(Some(LONG)).expect("a time limit");
    let length = body.len();
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {page}\r\nContent-Length: {length}\r\n{more}\r\n"
    );
    stream
        .write_all((head + body).as_bytes())
        .expect("the request leaves");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("an answer comes");
    let end = answer
        .windows(4)
        .position(|four| four == b"\r\n\r\n")
        .expect("a head");
    let head = String::from_utf8_lossy(&answer[..end]).into_owned();
    (head, answer[end + 4..].to_vec())
}

fn facts(page: &str) -> Value {
    let (head, body) = request(page, "GET", "/connect.json", "", "");
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    serde_json::from_slice(&body).expect("it is JSON")
}

/// The address of a URL of the facts.
fn address(url: &Value) -> String {
    let url = url.as_str().expect("a text");
    let address = url
        .strip_prefix("https://")
        .and_then(|rest| rest.strip_suffix('/'));
    address.expect("a URL of WebTransport").to_owned()
}

#[test]
fn the_page_comes_with_its_policy_and_its_client() {
    if !has_page() {
        return;
    }
    let server = SERVER.serve_with(ANYWHERE, &["--view", ANYWHERE]);
    let page = page(&server);
    for (path, begins) in [
        ("/", &b"<!doctype html>"[..]),
        ("/main.js", b"//"),
        ("/client/rhumb.wasm", b"\0asm"),
    ] {
        let (head, body) = request(&page, "GET", path, "", "");
        assert!(head.starts_with("HTTP/1.1 200"), "{path}: {head}");
        assert!(
            head.contains("content-security-policy: default-src 'none'"),
            "{head}"
        );
        assert!(body.starts_with(begins), "{path}");
    }
    let (head, _) = request(&page, "GET", "/nothing", "", "");
    assert!(head.starts_with("HTTP/1.1 404"), "{head}");
    let (head, body) = request(
        &page,
        "GET",
        "/connect.json",
        "Origin: http://elsewhere\r\n",
        "",
    );
    assert!(head.starts_with("HTTP/1.1 403"), "{head}");
    assert!(String::from_utf8_lossy(&body).contains("http://elsewhere"));
}

#[test]
fn a_client_that_takes_the_pages_way_passes_its_relay() {
    if !has_page() {
        return;
    }
    let server = SERVER.demo(&["--bodies", "20"]);
    let page = page(&server);
    let facts = facts(&page);
    assert_eq!(facts["scenes"][0]["name"], "ball-pit");
    assert_eq!(address(&facts["url"]), server.address.to_string());
    assert_eq!(facts["certificateHashes"].as_array().map(Vec::len), Some(2));
    let (head, body) = request(&page, "POST", "/link", "", "jitter=1ms");
    assert!(head.starts_with("HTTP/1.1 200"), "{head}");
    assert_eq!(body, b"jitter=1ms");
    let relay = address(&facts["conditionedUrl"]);
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&relay, trust).expect("the relay passes it on");
    let mut client = connection
        .join("ball-pit")
        .expect("the scene begins when it is named");
    client
        .idle(Duration::from_millis(1))
        .expect("it is a member");
    let replica = client.replica().expect("it is a member");
    let dynamic = replica
        .bodies()
        .filter(|body| body.kind == BodyKind::Dynamic);
    assert_eq!(dynamic.count(), 20);
    let (_, counts) = request(&page, "GET", "/link/counts", "", "");
    let counts: Value = serde_json::from_slice(&counts).expect("it is JSON");
    for direction in ["up", "down"] {
        assert!(
            counts[direction]["datagrams"].as_u64() > Some(0),
            "{counts}"
        );
    }
}

#[test]
fn the_pages_token_observes_and_does_nothing_else() {
    if !has_page() {
        return;
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let key = folder.path().join("key").display().to_string();
    let made = SERVER.run(&["token", "--new-key", &key]);
    assert_eq!(made.code, Some(0), "{}", made.log);
    let public = format!("{key}.pub");
    let more = ["--token-key", &public, "--view", ANYWHERE];
    let server = SERVER.serve_with(ANYWHERE, &more);
    let owner = SERVER.run(&[
        "token", "--key", &key, "--client", "owner", "--scene", "*", "--role", "owner",
    ]);
    let join = |token: &str| {
        let trust = Trust::Fingerprint(server.fingerprint);
        let connection = Client::connect(&server.address.to_string(), trust).expect("it listens");
        connection
            .token(token)
            .join_with("seen", JoinOptions::default())
    };
    let mut owner = join(owner.out.trim()).expect("an owner may create a scene");
    owner
        .advance(rhumb_client::PipelineDepth::LOCKSTEP)
        .expect("it steps");
    let token = facts(&page(&server))["token"]
        .as_str()
        .expect("there is a token")
        .to_owned();
    assert!(
        fs::read_dir(folder.path()).expect("it is there").count() == 2,
        "its key is in no file"
    );
    let mut observer = join(&token).expect("an observer may join");
    observer
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)))
        .expect("it is a body");
    observer.flush();
    let refused = loop {
        observer
            .idle(Duration::from_millis(1))
            .expect("it is a member");
        if let Some((_, Event::Refused { error, .. })) = observer.poll_event() {
            break error;
        }
    };
    assert_eq!(refused, CommandError::NotAllowed);
}

#[test]
fn a_page_for_other_machines_must_be_asked_for_twice() {
    let refused = SERVER.run(&["--open", "--listen", ANYWHERE, "--view", "0.0.0.0:0"]);
    assert_eq!(refused.code, Some(1));
    assert!(refused.log.contains("--open-to-network"), "{}", refused.log);
}

#[test]
fn the_demo_names_its_scenes() {
    let refused = SERVER.run(&["demo", "moon"]);
    assert_eq!(refused.code, Some(2));
    for name in ["ball-pit", "ragdolls", "cubes", "tumbler", "asteroids"] {
        assert!(refused.log.contains(name), "{}", refused.log);
    }
}
