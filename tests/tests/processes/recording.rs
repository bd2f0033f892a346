//! Recordings of a server process, and its scenes live in Foxglove's protocol.
//!
//! The states of a recording are compared with the bodies that a client sees at the same ticks.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use mcap::MessageStream;
use mcap::read::Options;
use prost::Message as _;
use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{BodyId, Client, PipelineDepth, Trust};
use rhumb_tests::ServerProcess;
use rhumb_trace::{SceneUpdate, TickStates, read_states};
use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::http::HeaderValue;
use tungstenite::http::header::ORIGIN;
use tungstenite::{HandshakeError, Message, WebSocket};

use crate::SERVER;

const ANYWHERE: &str = "127.0.0.1:0";
/// Longer than any answer takes; reached only by a failure.
const LONG: Duration = Duration::from_secs(30);
/// Steps until a chunk is on the disk, at most.
const STEPS_MAX: usize = 200_000;
/// The tolerance of the client's stream, metres, and the rounding of drawings.
const TOLERANCE_M: f64 = 0.05;
const ROUNDING_M: f64 = 0.002;

fn join(server: &ServerProcess, scene: &str) -> Client {
    let trust = Trust::Fingerprint(server.fingerprint);
    let address = server.address.to_string();
    let connection = Client::connect(&address, trust).expect("the server listens");
    connection.join(scene).expect("the scene begins")
}

/// A ball that rolls off a table for ever, and a floor.
fn populate(client: &mut Client) -> BodyId {
    let floor = BodyDesc::fixed(Shape::cuboid(50.0, 0.5, 50.0)).at(0.0, -0.5, 0.0);
    client.add_body(floor).expect("the floor is added");
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 20.0, 0.0);
    client.add_body(ball).expect("the ball is added")
}

/// Steps, and notes the ball's height at each tick.
fn step(client: &mut Client, ball: BodyId, heights: &mut BTreeMap<u64, f64>) {
    let tick = client.advance(PipelineDepth::LOCKSTEP).expect("it steps");
    let at = client.view().position(ball).expect("the ball is there");
    heights.insert(tick.value(), f64::from(at.y));
}

fn recordings(directory: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(directory).expect("the directory is there");
    let mut files: Vec<_> = entries
        .map(|entry| entry.expect("it can be read").path())
        .collect();
    files.sort();
    files
}

/// The states of a file up to its last whole chunk, and whether the file is complete.
fn states(path: &Path) -> (Vec<TickStates>, bool) {
    let bytes = fs::read(path).expect("the file can be read");
    let messages = MessageStream::new_with_options(&bytes, Options::IgnoreEndMagic.into());
    let mut states = Vec::new();
    for message in messages.expect("it is an MCAP file") {
        let Ok(message) = message else {
            return (states, false);
        };
        if message.channel.topic.ends_with("/truth/state") {
            let tick = read_states(&message.data).expect("it is a message");
            states.push(tick.expect("its numbers are valid"));
        }
    }
    let complete = mcap::Summary::read(&bytes).is_ok_and(|summary| summary.is_some());
    (states, complete)
}

/// Compares the recorded heights of the ball with those that the client saw.
fn compare(states: &[TickStates], ball: BodyId, heights: &BTreeMap<u64, f64>) {
    assert!(states.len() > 10, "{} ticks", states.len());
    let whole = &states[0];
    assert_eq!(whole.placed.len(), 2, "the first record is whole");
    let mut expected = whole.tick;
    let mut compared = 0;
    for tick in states {
        assert_eq!(tick.tick, expected, "no tick is missing");
        expected = expected.next();
        let observed = tick.observed.iter().find(|body| body.id == ball);
        if let (Some(body), Some(seen)) = (observed, heights.get(&tick.tick.value())) {
            let recorded = f64::from(body.motion.position()[1]);
            assert!((recorded - seen).abs() <= TOLERANCE_M, "at {}", tick.tick);
            compared += 1;
        }
    }
    assert!(compared > 10, "{compared} ticks compared");
}

#[test]
fn a_killed_servers_recording_is_read_up_to_its_last_chunk() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_str().expect("its name is text");
    let server = SERVER.serve_with(ANYWHERE, &["--record", path]);
    let mut client = join(&server, "team/pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    let is_written = || {
        let files = recordings(directory.path());
        files.iter().any(|file| states(file).0.len() > 50)
    };
    for steps in 0.. {
        assert!(steps < STEPS_MAX, "no chunk was written");
        step(&mut client, ball, &mut heights);
        if steps % 200 == 199 && is_written() {
            break;
        }
    }
    server.kill();
    let files = recordings(directory.path());
    assert_eq!(files.len(), 1, "{files:?}");
    let name = files[0].to_string_lossy().into_owned();
    assert!(name.ends_with(".team_pit.mcap"), "{name}");
    let (states, complete) = states(&files[0]);
    assert!(!complete, "the server was killed");
    compare(&states, ball, &heights);
}

#[test]
fn a_scene_that_ends_leaves_a_whole_file() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("made/here");
    let name = path.to_str().expect("its name is text");
    let server = SERVER.serve_with(ANYWHERE, &["--record", name]);
    let mut client = join(&server, "pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    for _ in 0..40 {
        step(&mut client, ball, &mut heights);
    }
    client.delete().expect("the scene ends");
    let files = recordings(&path);
    let mut tries = 0;
    let states = loop {
        let (states, complete) = states(&files[0]);
        if complete {
            break states;
        }
        tries += 1;
        assert!(tries < STEPS_MAX, "the file was not finished");
        std::thread::yield_now();
    };
    drop(server);
    assert_eq!(states.last().map(|states| states.tick.value()), Some(40));
    compare(&states, ball, &heights);
}

#[test]
#[cfg(target_os = "linux")]
fn worker_processes_record_their_scenes_in_one_directory() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_str().expect("its name is text");
    let server = SERVER.serve_with(ANYWHERE, &["--record", path, "--workers", "processes"]);
    let mut tenants: Vec<_> = ["one/pit", "other/pit"]
        .map(|scene| {
            let mut client = join(&server, scene);
            let ball = populate(&mut client);
            (client, ball, BTreeMap::new())
        })
        .into();
    for _ in 0..40 {
        for (client, ball, heights) in &mut tenants {
            step(client, *ball, heights);
        }
    }
    let seen: Vec<_> = tenants
        .into_iter()
        .map(|(mut client, ball, heights)| {
            client.delete().expect("the scene ends");
            (ball, heights)
        })
        .collect();
    let mut tries = 0;
    let recorded = loop {
        let files = recordings(directory.path());
        let recorded: Vec<_> = files.iter().map(|file| states(file)).collect();
        if recorded.len() == 2 && recorded.iter().all(|(_, complete)| *complete) {
            break recorded;
        }
        tries += 1;
        assert!(tries < STEPS_MAX, "the files were not finished");
        std::thread::yield_now();
    };
    drop(server);
    let names: Vec<_> = recordings(directory.path())
        .iter()
        .map(|file| file.to_string_lossy().into_owned())
        .collect();
    for (name, scene) in [(0, "one_pit"), (1, "other_pit")] {
        assert!(
            names
                .iter()
                .any(|file| file.ends_with(&format!(".{scene}.mcap"))),
            "{names:?}"
        );
        let (ball, heights) = &seen[name];
        let place = names.iter().position(|file| file.contains(scene));
        compare(&recorded[place.expect("it is there")].0, *ball, heights);
    }
}

/// The messages of a topic, in words that a file and the live protocol share; a schema's bytes are in Base64.
#[derive(Debug, PartialEq)]
struct Description {
    encoding: String,
    schema: String,
    schema_encoding: String,
    data: String,
}

/// The topics of a recording, with their descriptions.
fn described(path: &Path) -> BTreeMap<String, Description> {
    let bytes = fs::read(path).expect("the file can be read");
    let summary = mcap::Summary::read(&bytes).expect("it is an MCAP file");
    let channels = summary.expect("the file is whole").channels;
    let described = channels.into_values().map(|channel| {
        let schema = channel.schema.as_ref().expect("it has a schema");
        let description = Description {
            encoding: channel.message_encoding.clone(),
            schema: schema.name.clone(),
            schema_encoding: schema.encoding.clone(),
            data: base64(&schema.data),
        };
        (channel.topic.clone(), description)
    });
    described.collect()
}

/// Base64 with padding, as Foxglove's protocol writes schemas.
fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let bits = (group.iter()).fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
        let bits = bits << (8 * (3 - group.len()));
        for digit in 0..4 {
            let place = (bits >> (18 - 6 * digit) & 63) as usize;
            let is_padding = digit > group.len();
            text.push(if is_padding {
                '='
            } else {
                DIGITS[place].into()
            });
        }
    }
    text
}

/// A viewer of Foxglove's protocol.
struct Viewer(WebSocket<TcpStream>);

impl Viewer {
    fn connect(server: &ServerProcess) -> Self {
        Self::connect_from(server, None).expect("it is greeted")
    }

    /// The viewer of a web page, or the status with which it is refused.
    fn connect_from(server: &ServerProcess, page: Option<&'static str>) -> Result<Self, u16> {
        let line = server
            .lines
            .iter()
            .find_map(|line| line.strip_prefix("foxglove at "));
        let url = line.expect("a line names the address");
        let address = url.strip_prefix("ws://").expect("it is a URL");
        let stream = TcpStream::connect(address).expect("it listens");
        stream.set_read_timeout(Some(LONG)).expect("a time limit");
        let mut request = url.into_client_request().expect("it is a URL");
        let headers = request.headers_mut();
        headers.insert(
            "Sec-WebSocket-Protocol",
            HeaderValue::from_static("foxglove.sdk.v1"),
        );
        headers.extend(page.map(|page| (ORIGIN, HeaderValue::from_static(page))));
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Self(socket)),
            Err(HandshakeError::Failure(tungstenite::Error::Http(answer))) => {
                Err(answer.status().as_u16())
            }
            Err(cause) => panic!("neither greeted nor refused: {cause}"),
        }
    }

    /// The next message in JSON.
    fn json(&mut self) -> Value {
        loop {
            if let Message::Text(text) = self.0.read().expect("a message comes") {
                return serde_json::from_str(&text).expect("it is JSON");
            }
        }
    }

    /// The number of the channel of a topic, once it is announced, and its schema.
    fn channel(&mut self, topic: &str) -> (u64, String) {
        loop {
            let message = self.json();
            let channels = message["channels"].as_array().into_iter().flatten();
            for channel in channels {
                if channel["topic"] == topic {
                    let id = channel["id"].as_u64().expect("a number");
                    assert_eq!(channel["encoding"], "protobuf");
                    let schema = channel["schemaName"].as_str().expect("a name");
                    return (id, schema.to_owned());
                }
            }
        }
    }

    /// The announced channels, once these topics are among them: number and description by topic.
    fn channels(&mut self, topics: &BTreeSet<String>) -> BTreeMap<String, (u64, Description)> {
        let mut found = BTreeMap::new();
        while !topics.iter().all(|topic| found.contains_key(topic)) {
            let message = self.json();
            for channel in message["channels"].as_array().into_iter().flatten() {
                let text = |field: &str| channel[field].as_str().expect("a text").to_owned();
                let id = channel["id"].as_u64().expect("a number");
                let description = Description {
                    encoding: text("encoding"),
                    schema: text("schemaName"),
                    schema_encoding: text("schemaEncoding"),
                    data: text("schema"),
                };
                found.insert(text("topic"), (id, description));
            }
        }
        found
    }

    /// Numbers of the channels that are withdrawn, up to and including these.
    fn withdrawn(&mut self, awaited: &BTreeSet<u64>) -> BTreeSet<u64> {
        let mut gone = BTreeSet::new();
        while !awaited.is_subset(&gone) {
            let message = self.json();
            if message["op"] == "unadvertise" {
                let ids = message["channelIds"].as_array().expect("a list");
                gone.extend(ids.iter().filter_map(Value::as_u64));
            }
        }
        gone
    }

    fn subscribe(&mut self, channel: u64) {
        let subscription = serde_json::json!({
            "op": "subscribe", "subscriptions": [{"id": 7, "channelId": channel}]
        });
        let text = subscription.to_string();
        self.0
            .send(Message::text(text))
            .expect("the message leaves");
    }

    /// Time and bytes of the next message of the subscription.
    fn next(&mut self) -> (u64, Vec<u8>) {
        loop {
            if let Message::Binary(bytes) = self.0.read().expect("a message comes")
                && let [1, rest @ ..] = bytes.as_ref()
            {
                let (subscription, rest) = rest.split_at(4);
                assert_eq!(subscription, 7_u32.to_le_bytes());
                let (time, data) = rest.split_at(8);
                let time = u64::from_le_bytes(time.try_into().expect("eight bytes"));
                return (time, data.to_vec());
            }
        }
    }
}

#[test]
fn a_viewer_of_foxglove_sees_the_scene_where_it_is() {
    let server = SERVER.serve_with(ANYWHERE, &["--foxglove", ANYWHERE]);
    let mut client = join(&server, "team/pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    step(&mut client, ball, &mut heights);
    let mut viewer = Viewer::connect(&server);
    let (channel, schema) = viewer.channel("/team/pit/truth/moving");
    assert_eq!(schema, "foxglove.SceneUpdate");
    viewer.subscribe(channel);
    for _ in 0..60 {
        step(&mut client, ball, &mut heights);
    }
    let step_ns = 1e9 / 60.0;
    let mut compared = 0;
    while compared < 10 {
        let (time, data) = viewer.next();
        let update = SceneUpdate::decode(&*data).expect("it is a scene");
        let tick = (time as f64 / step_ns).round() as u64;
        let sphere = &update.entities[0].spheres[0];
        let at = sphere.pose.and_then(|pose| pose.position);
        // Foxglove's z axis points up.
        let drawn = at.expect("it has a place").z;
        let seen = heights[&tick];
        assert!(
            (drawn - seen).abs() <= TOLERANCE_M + ROUNDING_M,
            "{drawn} and {seen} at {tick}"
        );
        assert_eq!(sphere.size.map(|size| size.x), Some(1.0));
        compared += 1;
    }
}

#[test]
fn the_first_states_of_every_viewer_are_whole() {
    let server = SERVER.serve_with(ANYWHERE, &["--foxglove", ANYWHERE]);
    let mut client = join(&server, "pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    step(&mut client, ball, &mut heights);
    for number in 0..12 {
        let mut viewer = Viewer::connect(&server);
        let (channel, schema) = viewer.channel("/pit/truth/state");
        assert_eq!(schema, "rhumb.States");
        viewer.subscribe(channel);
        // The scene steps while the subscription arrives.
        for _ in 0..30 {
            step(&mut client, ball, &mut heights);
        }
        let (_, data) = viewer.next();
        let states = read_states(&data).expect("they are states");
        let placed = states.expect("they are valid").placed;
        assert_eq!(
            placed.len(),
            2,
            "the floor and the ball, of viewer {number}"
        );
    }
}

#[test]
fn a_layout_shows_what_a_viewer_is_offered() {
    let ended = SERVER.run(&["layout", "team/pit"]);
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    let layout: Value = serde_json::from_str(&ended.out).expect("it is JSON");
    let shown = layout["configById"]["3D!team/pit"]["topics"].as_object();
    let topics: BTreeSet<_> = shown.expect("topics").keys().cloned().collect();
    assert_eq!(topics.len(), 3);
    let server = SERVER.serve_with(ANYWHERE, &["--foxglove", ANYWHERE]);
    let mut client = join(&server, "team/pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    step(&mut client, ball, &mut heights);
    let offered = Viewer::connect(&server).channels(&topics);
    for topic in topics {
        assert_eq!(offered[&topic].1.schema, "foxglove.SceneUpdate", "{topic}");
    }
}

#[test]
fn a_viewer_that_comes_late_sees_a_scene_that_stands_still() {
    let server = SERVER.serve_with(ANYWHERE, &["--foxglove", ANYWHERE]);
    let mut client = join(&server, "pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    for _ in 0..10 {
        step(&mut client, ball, &mut heights);
    }
    for (topic, cubes, spheres) in [("static", 1, 0), ("moving", 0, 1)] {
        let mut viewer = Viewer::connect(&server);
        let (channel, _) = viewer.channel(&format!("/pit/truth/{topic}"));
        viewer.subscribe(channel);
        let (_, data) = viewer.next();
        let update = SceneUpdate::decode(&*data).expect("it is a scene");
        let entity = &update.entities[0];
        assert_eq!((entity.cubes.len(), entity.spheres.len()), (cubes, spheres));
    }
}

#[test]
fn a_viewer_is_offered_the_topics_and_schemas_of_a_recording() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().to_str().expect("its name is text");
    let server = SERVER.serve_with(ANYWHERE, &["--foxglove", ANYWHERE, "--record", path]);
    let mut client = join(&server, "pit");
    let (ball, mut heights) = (populate(&mut client), BTreeMap::new());
    for _ in 0..10 {
        step(&mut client, ball, &mut heights);
    }
    let topics = ["static", "moving", "resting", "poses", "state"];
    let topics: BTreeSet<_> = topics.map(|topic| format!("/pit/truth/{topic}")).into();
    let offered = {
        let mut left = Viewer::connect(&server);
        let offered = left.channels(&topics);
        left.subscribe(offered["/pit/truth/static"].0);
        let _ = left.next();
        offered
    };
    // The first viewer left without a word; a later one is offered the same, and is served.
    let mut viewer = Viewer::connect(&server);
    let server_info = viewer.json();
    assert_eq!(server_info["op"], "serverInfo");
    assert_eq!(
        server_info["capabilities"],
        serde_json::json!([]),
        "it takes nothing from viewers"
    );
    let again = viewer.channels(&topics);
    assert_eq!(again, offered);
    viewer.subscribe(again["/pit/truth/moving"].0);
    step(&mut client, ball, &mut heights);
    let (_, data) = viewer.next();
    let update = SceneUpdate::decode(&*data).expect("it is a scene");
    assert_eq!(update.entities[0].spheres.len(), 1);
    client.delete().expect("the scene ends");
    let numbers = again.values().map(|(number, _)| *number).collect();
    assert_eq!(viewer.withdrawn(&numbers), numbers, "the scene is gone");

    let file = &recordings(directory.path())[0];
    let mut tries = 0;
    while !states(file).1 {
        tries += 1;
        assert!(tries < STEPS_MAX, "the file was not finished");
        std::thread::yield_now();
    }
    let recorded = described(file);
    for (topic, (_, description)) in &offered {
        assert_eq!(recorded.get(topic), Some(description), "{topic}");
    }
}

#[test]
fn a_web_page_of_others_sees_no_scene() {
    let allowed = [
        "--foxglove",
        ANYWHERE,
        "--web-origin",
        "https://views.example",
    ];
    let server = SERVER.serve_with(ANYWHERE, &allowed);
    for page in [
        "http://localhost:8080",
        "https://app.foxglove.dev",
        "https://views.example",
    ] {
        let mut viewer = Viewer::connect_from(&server, Some(page)).expect("the page may see them");
        assert_eq!(viewer.json()["op"], "serverInfo", "{page}");
    }
    for page in ["https://other.example", "null"] {
        let refused = Viewer::connect_from(&server, Some(page)).err();
        assert_eq!(refused, Some(403), "{page}");
    }
}

#[test]
fn viewers_of_other_machines_need_to_be_allowed() {
    let refused = SERVER.run(&["--open", "--listen", ANYWHERE, "--foxglove", "0.0.0.0:0"]);
    assert_eq!(refused.code, Some(1), "{}", refused.out);
    assert!(refused.log.contains("--open-to-network"), "{}", refused.log);
}

#[test]
fn a_configuration_is_checked_as_a_start_checks_it() {
    for (wrong, reason) in [
        (
            &["--open", "--listen", "0.0.0.0:0"][..],
            "--open-to-network",
        ),
        (&["--open", "--view", "0.0.0.0:0"], "--open-to-network"),
        (&["--open", "--foxglove", "0.0.0.0:0"], "--open-to-network"),
        (&["--open", "--metrics", "0.0.0.0:0"], "--open-to-network"),
        (
            &["--open", "--app-listen", "0.0.0.0:0"],
            "--open-to-network",
        ),
        (
            &["--open", "--view", "--no-web"],
            if rhumb_viewer::UNAVAILABLE.is_none() {
                "--no-web"
            } else {
                "no page"
            },
        ),
        (&["--open", "--core", "9999"], "cores"),
        (
            &["--open", "--foxglove", "--workers", "processes"],
            "foxglove",
        ),
        (&["--token-key", "/nowhere/key"], "/nowhere/key"),
        (&[], "--token-key"),
    ] {
        let checked = SERVER.run(&[wrong, &["--check-config"]].concat());
        assert_eq!(checked.code, Some(1), "{wrong:?}: {}", checked.log);
        assert!(checked.log.contains(reason), "{wrong:?}: {}", checked.log);
        let started = SERVER.run(wrong);
        assert_eq!(started.code, Some(1), "{wrong:?}");
        assert_eq!(started.log, checked.log, "{wrong:?}");
    }
}

#[test]
fn the_directories_of_a_configuration_are_checked() {
    let directory = tempfile::tempdir().expect("a directory");
    let file = directory.path().join("file");
    fs::write(&file, b"").expect("a file");
    let (file, new) = (file.to_string_lossy(), directory.path().join("new/er"));
    let check = |flag, path: &str| SERVER.run(&["--open", "--check-config", flag, path]);
    for flag in ["--flight", "--record", "--data"] {
        let fine = check(flag, &new.to_string_lossy());
        assert_eq!(fine.code, Some(0), "{flag}: {}", fine.log);
        let refused = check(flag, &file);
        assert_eq!(refused.code, Some(1), "{flag}");
        assert!(refused.log.contains(&*file), "{}", refused.log);
    }
    assert!(!new.exists(), "a check makes nothing");
    if cfg!(target_os = "linux") {
        for flag in ["--flight", "--record"] {
            let refused = check(flag, "/proc/recordings");
            assert_eq!(refused.code, Some(1), "{flag}");
            assert!(refused.log.contains("takes no files"), "{}", refused.log);
        }
    }
}
