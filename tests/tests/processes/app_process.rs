//! A server process accepts the bytes of the real plug-in by TCP and UDP.
//!
//! The tests write recordings of the plug-in to the sockets of the server process as fast as it accepts them. A native
//! client watches the scene. Waiting is a read with a time limit, never a sleep.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Read, Write};
use std::net::{TcpStream, UdpSocket};
use std::time::{Duration, Instant};

use glam::Vec3;
use rhumb_app::{Kind, Logon, Message, MessageFraming};
use rhumb_client::scene::Shape;
use rhumb_client::{Client, ClientError, JoinMode, JoinOptions, PipelineDepth, Tick, Trust};
use rhumb_tests::{Recording, ServerProcess, falling, falling_apart};

use crate::SERVER;
use crate::hostile_load::{free_address, requested, uncrowded};

const ANYWHERE: &str = "127.0.0.1:0";
const ZOO: &[u8] = include_bytes!("../../data/app/harness_zoo.zst");
const BALLS: &[u8] = include_bytes!("../../data/app/harness_balls.zst");
/// Time limit of every wait.
const TIME_LIMIT: Duration = Duration::from_secs(60);

/// Number of frames before the native client joins.
const FRAMES_BEFORE_JOIN: usize = 45;

pub(crate) struct Plugin {
    tcp: TcpStream,
    udp: UdpSocket,
    frames: MessageFraming,
}

/// Panic message for socket operations.
const LOOPBACK: &str = "loopback works";

impl Plugin {
    fn connect(server: &ServerProcess, recording: &Recording) -> Self {
        Self::connect_with(server, recording.datagram())
    }

    /// Connects, and sends a datagram.
    fn connect_with(server: &ServerProcess, datagram: &[u8]) -> Self {
        let app = server.app.expect("the server listens for such clients");
        let udp = UdpSocket::bind(ANYWHERE).expect(LOOPBACK);
        udp.send_to(datagram, app).expect(LOOPBACK);
        udp.set_read_timeout(Some(TIME_LIMIT)).expect(LOOPBACK);
        let tcp = TcpStream::connect(app).expect(LOOPBACK);
        tcp.set_read_timeout(Some(TIME_LIMIT)).expect(LOOPBACK);
        Self {
            tcp,
            udp,
            frames: MessageFraming::default(),
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        self.tcp.write_all(bytes).expect(LOOPBACK);
    }

    /// Receives on TCP until the server closes the connection or this number of frames is over.
    fn receive(&mut self, frames: Option<usize>) -> Vec<Message> {
        let mut received: Vec<Message> = Vec::new();
        let mut buffer = [0; 4_096];
        let is_over = |message: &&Message| message.kind() == Kind::TimeAdvanced;
        while Some(received.iter().filter(is_over).count()) != frames {
            // A refused connection may be reset because of unread data.
            let count = self.tcp.read(&mut buffer).unwrap_or(0);
            if count == 0 {
                break;
            }
            self.frames.push(&buffer[..count]);
            while let Some(framed) = self.frames.next_message().expect("messages") {
                received.push(framed.message);
            }
        }
        received
    }
}

#[test]
fn a_session_of_the_plug_in_runs_to_its_end() {
    let server = SERVER.serve_app(ANYWHERE, &[]);
    let recording = Recording::unpack(ZOO);
    let mut plugin = Plugin::connect(&server, &recording);
    plugin.send(&recording.bytes);
    let received = plugin.receive(None);
    let count = |kind| received.iter().filter(|m| m.kind() == kind).count();
    assert_eq!(count(Kind::LogonReady), 1);
    let frames = recording.count(Kind::AdvanceTime);
    assert_eq!(count(Kind::TimeAdvanced), frames);
    assert_eq!(count(Kind::Error), 0);
    assert!(count(Kind::UpdateMass) >= 11);
    let mut datagram = [0; 2_048];
    let (bytes, _) = plugin.udp.recv_from(&mut datagram).unwrap();
    let first = Message::from_datagram(&datagram[..bytes]).unwrap();
    assert_eq!(first.kind(), Kind::SetDynamicActor);
    server.signal("TERM");
    let ended = server.wait();
    assert_eq!(ended.code, Some(0));
    let reported = ended.log.contains("an app client logged off");
    assert!(reported, "{}", ended.log);
}

/// The last reported position of each actor.
type LastPositions = BTreeMap<u32, Vec3>;

/// Sends messages frame by frame as the plug-in does, and stores the reported positions.
fn send_in_frames(
    plugin: &mut Plugin,
    pieces: &[&[u8]],
    messages: &[Message],
    reported: &mut LastPositions,
) {
    for (piece, message) in pieces.iter().zip(messages) {
        plugin.send(piece);
        if message.kind() != Kind::AdvanceTime {
            continue;
        }
        for received in plugin.receive(Some(1)) {
            if let Message::SetDynamicActor(state) = received {
                reported.insert(state.actor.object, state.position);
            }
        }
    }
}

/// The metrics of the scene of simulation 7 count the plug-in as a member.
fn assert_scene_is_counted(metrics: &str) {
    let figures = requested(metrics, "/metrics");
    let value = |metric: &str| {
        let name = format!("rhumb_scene_{metric}{{scene=\"app/7\"}} ");
        let mut values = figures.lines().filter_map(|line| line.strip_prefix(&*name));
        let value = values.next().and_then(|value| value.parse::<f64>().ok());
        value.unwrap_or_else(|| panic!("{name} in\n{figures}"))
    };
    for metric in [
        "members",
        "tick",
        "commands_total",
        "received_bytes_total",
        "sent_bytes_total",
    ] {
        assert!(value(metric) > 0.0, "{metric}");
    }
}

#[test]
fn a_native_client_watches_a_scene_of_the_plug_in() {
    let metrics = free_address();
    let server = SERVER.serve_app(ANYWHERE, &["--metrics", &metrics]);
    let recording = Recording::unpack(BALLS);
    // Without its datagram the plug-in receives all states on TCP, in order.
    let mut plugin = Plugin::connect_with(&server, b"no logon");
    let pieces: Vec<&[u8]> = recording.pieces().collect();
    let is_frame = |place: &usize| recording.messages[*place].kind() == Kind::AdvanceTime;
    let frames: Vec<usize> = (0..pieces.len()).filter(is_frame).collect();
    let mut reported = LastPositions::new();
    let mut sent = 0;
    let mut send_up_to = |plugin: &mut Plugin, end: usize, reported: &mut LastPositions| {
        send_in_frames(
            plugin,
            &pieces[sent..end],
            &recording.messages[sent..end],
            reported,
        );
        sent = end;
    };
    send_up_to(
        &mut plugin,
        frames[FRAMES_BEFORE_JOIN - 1] + 1,
        &mut reported,
    );
    let trust = Trust::Fingerprint(server.fingerprint);
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let connection = Client::connect(&server.address.to_string(), trust).unwrap();
    let mut client = connection.join_with("app/7", options).unwrap();
    assert_scene_is_counted(&metrics);
    let copy = client.replica().expect("it has joined");
    let shapes: Vec<Shape> = copy
        .bodies()
        .filter_map(|desc| copy.shape(desc.shape).cloned())
        .collect();
    let is_ground = |shape: &&Shape| matches!(shape, Shape::Heights(_));
    assert_eq!(shapes.iter().filter(is_ground).count(), 1);
    let is_ball = |shape: &&Shape| matches!(shape, Shape::Ball { .. });
    assert_eq!(shapes.iter().filter(is_ball).count(), 40);
    // Both receive the same bodies by different protocols, so their positions agree within the sum of both tolerances.
    let step = Tick::new(client.statistics().complete.value() / FRAMES_BEFORE_JOIN as u64);
    for frame in FRAMES_BEFORE_JOIN + 1..frames.len() {
        send_up_to(&mut plugin, frames[frame - 1] + 1, &mut reported);
        let tick = Tick::new(step.value() * frame as u64);
        while client.statistics().complete < tick {
            client.idle(Duration::from_millis(5)).unwrap();
        }
        assert_eq!(client.wait(PipelineDepth::LOCKSTEP).unwrap(), tick);
        for (actor, position) in &reported {
            let shown = client.view().positions().iter();
            let off = shown.map(|other| other.distance(*position));
            let off = off.fold(f32::INFINITY, f32::min);
            assert!(off <= 0.052, "{actor} differs by {off} m at {tick}");
        }
    }
    assert_eq!(reported.len(), 40);
    send_up_to(&mut plugin, pieces.len(), &mut reported);
    let ended = loop {
        if let Err(error) = client.idle(TIME_LIMIT) {
            break error;
        }
    };
    assert!(matches!(ended, ClientError::SceneDeleted), "{ended}");
}

/// A client that owns a scene of some bodies, named by this number.
pub(crate) fn falling_plugin(server: &ServerProcess, simulation: u32) -> Plugin {
    let mut logon = Vec::new();
    Message::Logon(Logon::new(simulation, "falling")).encode(0, &mut logon);
    let mut plugin = Plugin::connect_with(server, &logon);
    plugin.send(&falling(simulation, 10));
    plugin.send(&frame(simulation));
    plugin
}

#[test]
fn states_are_not_sent_faster_than_the_operator_allows() {
    const BODIES: u32 = 100;
    let server = SERVER.serve_app(ANYWHERE, &["--app-datagram-rate", "1"]);
    let mut logon = Vec::new();
    Message::Logon(Logon::new(7, "falling")).encode(0, &mut logon);
    let mut plugin = Plugin::connect_with(&server, &logon);
    plugin.send(&falling(7, BODIES));
    // Started before the first state is sent: delays of the reader can only make the measured time longer.
    let begun = Instant::now();
    plugin.send(&frame(7));
    let mut datagram = [0; 2_048];
    let mut reported = BTreeSet::new();
    while reported.len() < BODIES as usize {
        let (bytes, _) = plugin.udp.recv_from(&mut datagram).unwrap();
        match Message::from_datagram(&datagram[..bytes]).unwrap() {
            Message::SetDynamicActor(state) => reported.insert(state.actor.object),
            other => panic!("{other:?} is not a state"),
        };
    }
    let took = begun.elapsed();
    // The datagrams of three milliseconds may leave at once.
    let least = Duration::from_millis(u64::from(BODIES) - 3);
    assert!(took >= least, "all states were sent after {took:?}");
}

#[test]
fn connections_that_say_nothing_leave_their_places() {
    const CONNECTIONS: usize = 64;
    let server = SERVER.serve_app(ANYWHERE, &[]);
    let app = server.app.expect("the server listens for such clients");
    let connect = |_| {
        let stream = TcpStream::connect(app).expect(LOOPBACK);
        stream.set_read_timeout(Some(TIME_LIMIT)).expect(LOOPBACK);
        stream
    };
    let mut silent: Vec<TcpStream> = (0..CONNECTIONS).map(connect).collect();
    let mut one_more = connect(CONNECTIONS);
    let ends = |stream: &mut TcpStream| stream.read(&mut [0]).expect("it is closed") == 0;
    assert!(ends(&mut one_more), "a connection beyond the places");
    assert!(silent.iter_mut().all(ends), "connections without a byte");
    let recording = Recording::unpack(ZOO);
    let mut plugin = Plugin::connect(&server, &recording);
    plugin.send(&recording.bytes);
    let received = plugin.receive(Some(1));
    assert_eq!(received[0].kind(), Kind::LogonReady);
}

#[test]
fn noise_ends_its_own_connection_with_a_reason() {
    let server = SERVER.serve_app(ANYWHERE, &[]);
    let recording = Recording::unpack(ZOO);
    let mut noisy = Plugin::connect(&server, &recording);
    noisy.send(b"GET / HTTP/1.1\r\nHost: physics\r\n\r\n");
    assert!(noisy.receive(None).is_empty());
    let mut early = Plugin::connect(&server, &recording);
    early.send(&recording.bytes[76..200]);
    assert!(early.receive(None).is_empty());
    let mut plugin = Plugin::connect(&server, &recording);
    plugin.send(&recording.bytes);
    assert!(!plugin.receive(None).is_empty());
    server.signal("TERM");
    let log = server.wait().log;
    assert!(log.contains("version 18245 is not supported"), "{log}");
    assert!(log.contains("the first message was not a logon"), "{log}");
}

/// The messages of one frame of a simulation.
fn frame(simulation: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    Message::AdvanceTime((simulation, 0.089)).encode(0, &mut bytes);
    bytes
}

#[test]
fn a_client_that_overloads_its_scene_is_closed_and_stops_no_other() {
    let metrics = free_address();
    let directory = tempfile::tempdir().expect("a temporary directory");
    let config = uncrowded(directory.path());
    let server = SERVER.serve_app(ANYWHERE, &["--metrics", &metrics, "--config", &config]);
    let mut second = Plugin::connect_with(&server, b"no logon");
    second.send(&falling(8, 10));
    let mut heap = Plugin::connect_with(&server, b"no logon");
    heap.send(&falling_apart(7, 5_000, 0.0));
    heap.send(&frame(7));
    let over = |received: &[Message]| {
        let over = received.iter().filter(|m| m.kind() == Kind::TimeAdvanced);
        over.count()
    };
    for _ in 0..50 {
        second.send(&frame(8));
        assert_eq!(over(&second.receive(Some(1))), 1, "it was closed");
    }
    assert_eq!(over(&heap.receive(None)), 0, "its first frame ends");
    second.send(&frame(8));
    assert_eq!(over(&second.receive(Some(1))), 1, "it was closed");
    let figures = requested(&metrics, "/metrics");
    for line in [
        "rhumb_scenes_quarantined 1",
        "rhumb_closed_total{code=\"6\"} 1",
        "rhumb_scene_members{scene=\"app/8\"} 1",
    ] {
        assert!(
            figures.lines().any(|have| have == line),
            "{line} in\n{figures}"
        );
    }
    server.signal("TERM");
    let ended = server.wait();
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    assert!(ended.log.contains("its scene has ended"), "{}", ended.log);
}

#[test]
fn a_client_without_datagrams_receives_a_thousand_bodies_without_overflow() {
    const BODIES: u32 = 1_000;
    // Sending all states of all frames would exceed the four megabytes that may be queued for a client many times.
    const FRAMES: usize = 250;
    let server = SERVER.serve_app(ANYWHERE, &[]);
    let mut plugin = Plugin::connect_with(&server, b"no logon");
    plugin.send(&falling(7, BODIES));
    // The answers to another client's frames show when the frames of the first one were read. So each frame arrives in
    // a read of its own, as from a plug-in, but faster.
    let mut second = Plugin::connect_with(&server, b"no logon");
    second.send(&falling(8, 0));
    for _ in 0..FRAMES {
        plugin.send(&frame(7));
        second.send(&frame(8));
        second.receive(Some(1));
    }
    let over = |received: &[Message]| {
        let over = received.iter().filter(|m| m.kind() == Kind::TimeAdvanced);
        over.count()
    };
    assert_eq!(over(&plugin.receive(Some(FRAMES))), FRAMES, "it was closed");
    // After a client has received everything, each body is reported within two frames.
    let mut reported = BTreeSet::new();
    for _ in 0..2 {
        plugin.send(&frame(7));
        let received = plugin.receive(Some(1));
        assert_eq!(over(&received), 1, "it was closed");
        reported.extend(received.iter().filter_map(|message| match message {
            Message::SetDynamicActor(state) => Some(state.actor.object),
            _ => None,
        }));
    }
    assert_eq!(reported.len(), BODIES as usize);
    server.signal("TERM");
    let log = server.wait().log;
    assert!(!log.contains("reads too slowly"), "{log}");
}
