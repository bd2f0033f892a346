//! A server that reports to a stand-in for the sidecar of Agones.
//!
//! The stand-in answers as the sidecar of version 1.57 does (`pkg/sdkserver`): an error has status 500, whatever its kind, and a
//! list without values leaves them out.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use rhumb_client::scene::SceneConfig;
use rhumb_client::{Client, JoinMode, JoinOptions, Trust};
use rhumb_tests::ServerProcess;

use crate::SERVER;
use crate::durable::until;
use crate::hostile_load::free_address;

/// The reports that the sidecar has got.
#[derive(Debug, Default)]
struct GameServer {
    /// The states that were asked for, in order.
    states: Vec<String>,
    healths: usize,
    labels: Vec<String>,
    scenes: Vec<String>,
}

/// A sidecar at an address, for as long as the test runs.
#[derive(Clone)]
struct StandIn(Arc<Mutex<GameServer>>);

impl StandIn {
    fn start(address: &str, promised: &[&str]) -> Self {
        let listener = TcpListener::bind(address).expect("a free port");
        let promised = promised.iter().map(|name| (*name).to_owned()).collect();
        let sidecar = Self(Arc::new(Mutex::new(GameServer {
            scenes: promised,
            ..GameServer::default()
        })));
        let answering = sidecar.clone();
        thread::spawn(move || {
            for stream in listener.incoming() {
                answering.answer(stream.expect("a connection"));
            }
        });
        sidecar
    }

    fn read<T>(&self, of: impl FnOnce(&mut GameServer) -> T) -> T {
        of(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn answer(&self, mut stream: TcpStream) {
        let (head, body) = request(&stream);
        let (status, answer) = self.read(|server| server.take(&head, &body));
        let length = answer.len();
        let answer = format!(
            "HTTP/1.1 {status} Status\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n{answer}"
        );
        stream
            .write_all(answer.as_bytes())
            .expect("the server listens");
    }

    fn state(&self) -> Option<String> {
        self.read(|server| server.states.last().cloned())
    }

    fn scenes(&self) -> Vec<String> {
        self.read(|server| server.scenes.clone())
    }
}

/// The first line of a request, and its body.
fn request(stream: &TcpStream) -> (String, String) {
    let mut lines = BufReader::new(stream);
    let (mut head, mut length) = (String::new(), 0);
    loop {
        let mut line = String::new();
        lines.read_line(&mut line).expect("a request is text");
        let line = line.trim_end();
        if line.is_empty() {
            break;
        }
        if head.is_empty() {
            head = line.to_owned();
        }
        if let Some((name, value)) = line.split_once(": ")
            && name.eq_ignore_ascii_case("content-length")
        {
            length = value.parse().expect("a length");
        }
    }
    let mut body = vec![0; length];
    lines.read_exact(&mut body).expect("the body comes");
    (head, String::from_utf8(body).expect("JSON is text"))
}

impl GameServer {
    fn take(&mut self, head: &str, body: &str) -> (u16, String) {
        let value = body.split('"').nth(3).unwrap_or_default().to_owned();
        let done = (200, "{}".to_owned());
        match head.trim_end_matches(" HTTP/1.1") {
            state @ ("POST /ready" | "POST /allocate" | "POST /shutdown") => {
                self.states
                    .push(state.trim_start_matches("POST /").to_owned());
                done
            }
            "POST /health" => {
                self.healths += 1;
                done
            }
            "PUT /metadata/label" => {
                self.labels.push(body.to_owned());
                done
            }
            "GET /v1beta1/lists/scenes" => (200, self.list()),
            "POST /v1beta1/lists/scenes:addValue" if !self.scenes.contains(&value) => {
                self.scenes.push(value);
                (200, self.list())
            }
            "POST /v1beta1/lists/scenes:removeValue" if self.scenes.contains(&value) => {
                self.scenes.retain(|scene| *scene != value);
                (200, self.list())
            }
            other => {
                let error = format!(r#"{{"code":2, "message":"{other}", "details":[]}}"#);
                (500, error)
            }
        }
    }

    fn list(&self) -> String {
        if self.scenes.is_empty() {
            return r#"{"name":"scenes", "capacity":"4"}"#.to_owned();
        }
        let scenes = &self.scenes;
        format!(r#"{{"name":"scenes", "capacity":"4", "values":{scenes:?}}}"#)
    }
}

fn create(server: &ServerProcess, scene: &str) -> Client {
    let address = server.address.to_string();
    let connection = Client::connect(&address, Trust::Fingerprint(server.fingerprint));
    let options = JoinOptions {
        mode: JoinMode::Create(SceneConfig::default()),
        ..JoinOptions::default()
    };
    let connection = connection.expect("the server is there");
    connection.join_with(scene, options).expect("a new scene")
}

#[test]
fn agones_knows_a_server_and_its_scenes() {
    let address = free_address();
    let (_, port) = address.rsplit_once(':').expect("an address has a port");
    let server = SERVER.serve_with_variable(
        ("AGONES_SDK_HTTP_PORT", port),
        &["--agones", "--listen", "127.0.0.1:0"],
    );
    // The sidecar starts after the server, which has asked it by then or has not.
    let mut early = create(&server, "early");
    let sidecar = StandIn::start(&address, &["promised"]);
    until("the server is allocated", || {
        sidecar.state().as_deref() == Some("allocate")
    });
    until("its scene is listed", || {
        sidecar.scenes() == ["promised", "early"]
    });
    let mut late = create(&server, "late");
    until("another is", || {
        sidecar.scenes() == ["promised", "early", "late"]
    });
    early.delete().expect("it may");
    until("one has ended", || sidecar.scenes() == ["promised", "late"]);
    assert_eq!(sidecar.state().as_deref(), Some("allocate"));
    late.delete().expect("it may");
    until("all have", || sidecar.scenes() == ["promised"]);
    until("the server is ready again", || {
        sidecar.state().as_deref() == Some("ready")
    });
    let healths = sidecar.read(|sidecar| sidecar.healths);
    until("it is well", || {
        sidecar.read(|sidecar| sidecar.healths) > healths + 1
    });
    server.signal("TERM");
    let ended = server.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    let states = sidecar.read(|sidecar| sidecar.states.clone());
    assert_eq!(states, ["ready", "allocate", "ready", "shutdown"]);
    assert!(
        sidecar.read(|sidecar| sidecar.labels.is_empty()),
        "it did not drain"
    );
}

#[test]
fn a_port_of_agones_that_is_none_refuses_the_start() {
    let ended = SERVER.run_with_variable(("AGONES_SDK_HTTP_PORT", "http"), &["--open", "--agones"]);
    assert_eq!(ended.code, Some(1));
    let text = r#"AGONES_SDK_HTTP_PORT is "http": Agones sets it to a port"#;
    assert!(ended.log.contains(text), "{}", ended.log);
}
