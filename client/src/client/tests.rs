//! Calls of a client whose server is a script.
//!
//! It has a lockstep scene with one kinematic body, grants authority over it, and answers each message of queries with
//! the number of the connection as tick.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use bytes::Bytes;
use glam::Vec3;
use rhumb_link::{ClientTransport, Received, WireStatistics};
use rhumb_protocol::Ending;
use rhumb_protocol::message::{
    AuthorityGrant, ClientMessage, Extension, Extensions, Frames, Joined, QueryResult, SceneEvent,
    ServerMessage, SessionState, StreamChoice, VERSIONS, Welcome,
};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{BodyDesc, IdRange, Query, SceneConfig, Shape, ShapeId};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::{Features, StreamConfig};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance, Track};
use rhumb_view::PipelineDepth;

use super::Client;
use crate::connection::{BoxedConnection, Redial};
use crate::error::ClientError;
use crate::join_options::JoinOptions;
use crate::server_connection::ServerConnection;

const BODY: BodyId = BodyId::new(0, 0);
const STREAM: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// A server of one client.
#[derive(Default)]
struct Script {
    frames: Frames,
    to_client: VecDeque<Received>,
    /// Connections so far.
    connections: u64,
    /// Messages of queries over this connection.
    queries: u64,
    /// Messages of queries at which the connection breaks instead of an answer.
    breaks: u64,
    commands: u64,
    /// True for a server that says that another one has the scene.
    names_another: bool,
    /// Of each attempt to connect again: true if it was to the named server.
    attempts: Vec<bool>,
    /// Attempts at the named server that fail.
    unreachable: usize,
}

/// Where the script says that another server is.
const ANOTHER: &str = "rhumb://another:1";

/// A connection to the script.
struct ScriptedConnection(Arc<Mutex<Script>>);

impl Script {
    fn send(&mut self, message: &ServerMessage) {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        self.to_client.push_back(Received::Control(bytes.into()));
    }

    fn end(&mut self) {
        self.to_client.push_back(Received::Ended(Ending::Broken));
    }

    fn handle(&mut self, message: &ClientMessage) {
        match message {
            ClientMessage::Hello { .. } => {
                let mut extensions = Extensions::NONE;
                if self.names_another {
                    let id = Extension::ELSEWHERE;
                    let value = ANOTHER.as_bytes().to_vec();
                    assert!(extensions.insert(Extension { id, value }));
                }
                self.send(&ServerMessage::Welcome(Welcome {
                    version: VERSIONS[0],
                    scene: Some(SceneConfig::default()),
                    extensions,
                }));
            }
            ClientMessage::Session(_) => self.send(&ServerMessage::Session(SessionState {
                resumed: self.connections > 1,
                durable: false,
                commands: self.commands,
                tick: Tick::ZERO,
            })),
            ClientMessage::Join(_) => self.take_in(),
            ClientMessage::Ping { sent } => self.send(&ServerMessage::Pong {
                sent: *sent,
                tick: Tick::ZERO,
                since_tick_ns: 0,
            }),
            ClientMessage::Command(_) => self.commands += 1,
            ClientMessage::Query(_) if self.breaks > 0 => {
                self.breaks -= 1;
                self.end();
            }
            ClientMessage::Query(_) => {
                self.send(&ServerMessage::QueryResult(QueryResult {
                    number: self.queries,
                    tick: Tick::new(self.connections),
                    answers: Ok(Vec::new()),
                }));
                self.queries += 1;
            }
            ClientMessage::TakeAuthority(request) => {
                let bodies = request.bodies.iter().map(|id| (*id, body().1));
                self.send(&ServerMessage::AuthorityGrant(AuthorityGrant {
                    stream: StreamId(9),
                    tick: Tick::ZERO,
                    bodies: bodies.collect(),
                }));
            }
            _ => {}
        }
    }

    /// Sends the answer to a join: a scene with one body.
    fn take_in(&mut self) {
        let config = SceneConfig::default();
        let stream = StreamConfig {
            tolerance: Tolerance::NORMAL,
            integrator: config.integrator,
            publish_interval: config.publish_schedule.publish_interval,
            gravity: config.gravity,
            largest_packet: LargestPacket::DEFAULT,
            features: Features::ALL,
        };
        self.send(&ServerMessage::Joined(Joined {
            choice: STREAM,
            config,
            start: stream.start(StreamId(0), Tick::ZERO),
            granted: IdRange::new(0, 16, 0).expect("few ids"),
            extensions: Extensions::NONE,
        }));
        let (desc, motion) = body();
        let shape = Shape::ball(0.5);
        let events = [
            SceneEvent::ShapeAdded {
                id: desc.shape,
                shape,
            },
            SceneEvent::BodyPlaced {
                desc,
                inertia: None,
                track: Track::resting(Tick::ZERO, motion),
                alias: None,
            },
        ];
        for event in events {
            self.send(&ServerMessage::SceneEvent(event));
        }
        self.send(&ServerMessage::SnapshotEnd);
    }
}

impl ClientTransport for ScriptedConnection {
    fn send_control(&self, bytes: Bytes) {
        let mut script = lock(&self.0);
        script.frames.push(&bytes);
        while let Ok(Some(framed)) = script.frames.next_frame() {
            if let Ok(Some(message)) = ClientMessage::decode(&framed) {
                script.handle(&message);
            }
        }
    }

    fn send_state(&self, _bytes: Bytes) {}

    fn close(&self, _code: u32) {}

    fn recv(&mut self, _timeout: Duration) -> Option<Received> {
        lock(&self.0).to_client.pop_front()
    }

    fn statistics(&self) -> WireStatistics {
        WireStatistics::default()
    }
}

fn lock(script: &Mutex<Script>) -> MutexGuard<'_, Script> {
    script.lock().unwrap_or_else(PoisonError::into_inner)
}

fn connect(script: &Arc<Mutex<Script>>) -> BoxedConnection {
    let mut fresh = lock(script);
    *fresh = Script {
        connections: fresh.connections + 1,
        commands: fresh.commands,
        breaks: fresh.breaks,
        names_another: fresh.names_another,
        attempts: std::mem::take(&mut fresh.attempts),
        unreachable: fresh.unreachable,
        ..Script::default()
    };
    Box::new(ScriptedConnection(Arc::clone(script)))
}

/// The body of the scene, and its state.
fn body() -> (BodyDesc, BodyState) {
    let body = BodyDesc::kinematic(Shape::ball(0.5));
    let state = body.state().expect("these numbers are finite");
    (body.desc(BODY, ShapeId(0)), state)
}

/// A connection to a server, and the server.
fn connection() -> (ServerConnection, Arc<Mutex<Script>>) {
    let script = Arc::<Mutex<Script>>::default();
    let again = Arc::clone(&script);
    let redial: Redial = Arc::new(move |place, _| {
        let mut script = lock(&again);
        script.attempts.push(place == Some(ANOTHER));
        if place.is_some() && script.unreachable > 0 {
            script.unreachable -= 1;
            return None;
        }
        drop(script);
        Some(connect(&again))
    });
    (
        ServerConnection::with_redial(connect(&script), redial),
        script,
    )
}

/// A member of the scene, and its server.
fn member() -> (Client, Arc<Mutex<Script>>) {
    let (connection, script) = connection();
    let options = JoinOptions {
        resume_within: Some(Duration::from_secs(60)),
        ..JoinOptions::default()
    };
    let client = connection.join_with("script", options);
    (client.expect("the script takes it in"), script)
}

/// Ends the connection, which the client notices.
fn interrupt(client: &mut Client, script: &Mutex<Script>) {
    lock(script).end();
    client.idle(Duration::ZERO).expect("it tries on");
    assert!(client.interrupted.is_some());
}

/// Waits until the session continues.
fn resume(client: &mut Client) {
    while client.interrupted.is_some() {
        client.idle(Duration::from_millis(1)).expect("it tries on");
    }
}

fn ray() -> Vec<Query> {
    vec![Query::ray(Vec3::ZERO, Vec3::Y)]
}

#[test]
fn the_answer_to_an_earlier_connections_question_is_not_taken_for_a_later_one() {
    let (mut client, script) = member();
    client.query(ray()).expect("a member may");
    client.idle(Duration::from_millis(1)).expect("it is open");
    interrupt(&mut client, &script);
    resume(&mut client);
    let asked = client.ask(ray()).expect("the script answers");
    assert_eq!(asked.tick, Tick::new(2));
    let unread = std::iter::from_fn(|| client.poll_event());
    let unread = unread.filter_map(|(_, event)| match event {
        Event::QueryResult(result) => Some(result),
        _ => None,
    });
    let unread: Vec<QueryResult> = unread.collect();
    assert_eq!((unread.len(), unread[0].tick), (1, Tick::new(1)));
    assert_ne!(unread[0].number, asked.number);
}

#[test]
fn queries_that_an_ended_connection_left_unanswered_are_asked_again() {
    let (mut client, script) = member();
    lock(&script).breaks = 2;
    let asked = client.ask(ray()).expect("the script answers");
    assert_eq!(asked.tick, Tick::new(3));
    interrupt(&mut client, &script);
    let asked = client.ask(ray()).expect("the script answers");
    assert_eq!(asked.tick, Tick::new(4));
}

#[test]
fn an_interrupted_client_may_publish_and_regains_its_authority() {
    let (mut client, script) = member();
    let states = [(BODY, body().1)];
    let taken = client.take_authority(&[BODY], Tolerance::FINE);
    taken.expect("a member may");
    client.idle(Duration::from_millis(1)).expect("it is open");
    let publish = |client: &mut Client| {
        let published = client.publish(&states);
        published.expect("it has or regains the authority")
    };
    assert!(publish(&mut client).is_some());
    interrupt(&mut client, &script);
    assert_eq!(publish(&mut client), None);
    resume(&mut client);
    client.idle(Duration::from_millis(1)).expect("it is open");
    assert!(publish(&mut client).is_some());
    assert_eq!(client.authority_bodies().collect::<Vec<_>>(), [BODY]);
}

#[test]
fn a_delay_lead_or_depth_outside_its_limits_is_refused_with_them() {
    let (mut client, _script) = member();
    for ticks in [-1.0, f64::NAN, f64::INFINITY, 3_600.5, 1e9] {
        let delay = JoinOptions {
            delay_ticks: ticks,
            ..JoinOptions::default()
        };
        let lead = JoinOptions {
            lead_ticks: ticks,
            ..JoinOptions::default()
        };
        for options in [delay, lead] {
            let joined = connection().0.join_with("script", options);
            let error = joined.map(|_| ()).expect_err("a wrong number of ticks");
            assert!(
                error.to_string().ends_with(", and must be 0 to 3600"),
                "{error}"
            );
        }
        client
            .set_lead_ticks(ticks)
            .expect_err("a wrong number of ticks");
    }
    client.set_lead_ticks(2.5).expect("a number of ticks");
    let advanced = client.advance(PipelineDepth::new(65));
    let error = advanced.expect_err("a depth beyond the limit");
    let text = "the pipeline depth is 65, and must be 0 to 64";
    assert_eq!(error.to_string(), text);
}

#[test]
fn an_answer_that_has_arrived_counts_though_its_time_is_over() {
    let (mut client, _script) = member();
    // As of a process that stood still while it waited.
    client.timeout = Duration::ZERO;
    client.ask(ray()).expect("the answer is there");
    let advanced = client.advance(PipelineDepth::LOCKSTEP);
    assert!(
        matches!(advanced, Err(ClientError::Timeout { .. })),
        "{advanced:?}"
    );
}

#[test]
fn servers_that_name_each_other_are_asked_with_pauses() {
    let (mut client, script) = member();
    lock(&script).names_another = true;
    interrupt(&mut client, &script);
    while lock(&script).attempts.len() < 20 {
        client.idle(Duration::from_millis(1)).expect("it tries on");
    }
    lock(&script).names_another = false;
    resume(&mut client);
    let attempts = lock(&script).attempts.clone();
    // Each turn begins after a pause.
    let mut turns = attempts.split(|is_named| !is_named).skip(1);
    assert!(!attempts[0], "the first attempt has no other server to try");
    assert!(turns.all(|turn| turn.len() <= 8), "{attempts:?}");
}

#[test]
fn a_join_asks_the_first_server_again_where_the_named_one_does_not_answer() {
    let (connection, script) = connection();
    (lock(&script).names_another, lock(&script).unreachable) = (true, 1);
    let of_server = Arc::clone(&script);
    let joined = std::thread::spawn(move || {
        let options = JoinOptions::default();
        connection.join_with("script", options).map(|_| ())
    });
    // The first server has the scene as soon as it is asked again.
    while lock(&of_server).attempts.is_empty() {
        std::thread::yield_now();
    }
    lock(&of_server).names_another = false;
    joined.join().expect("it does not panic").expect("a scene");
    assert_eq!(lock(&script).attempts, [true, false]);
}
