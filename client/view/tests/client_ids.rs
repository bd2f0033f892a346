//! Ids and shape numbers for the bodies of one client.
//!
//! Proved on the session of a member whose server is a few messages.

use std::collections::BTreeSet;

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::message::{Extensions, Joined, ServerMessage, StreamChoice, VERSIONS, Welcome};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Command, CommandError, IdRange, SceneConfig, Shape, ShapeId,
};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::stream::{Features, StreamConfig};
use rhumb_protocol::{Endpoint as _, Instant, Peer};
use rhumb_reckoning::{BodyState, Tick, Tolerance};
use rhumb_view::{AddError, ClientIds};

/// The one peer of a client.
const SERVER: Peer = Peer(0);

/// Ids that the member has.
const GRANTED: u32 = 16;

fn granted() -> IdRange {
    IdRange::new(0, GRANTED, 0).expect("few ids")
}

/// The messages by which a server takes a member into an empty scene. `before`: those before `Joined`.
fn entry(before: &[ServerMessage], bodies: Vec<ServerMessage>) -> Vec<ServerMessage> {
    let config = SceneConfig::default();
    let stream = StreamConfig {
        tolerance: Tolerance::NORMAL,
        integrator: config.integrator,
        publish_interval: config.publish_schedule.publish_interval,
        gravity: config.gravity,
        largest_packet: LargestPacket::DEFAULT,
        features: Features::ALL,
    };
    let mut messages = vec![ServerMessage::Welcome(Welcome {
        version: VERSIONS[0],
        scene: Some(config),
        extensions: Extensions::NONE,
    })];
    messages.extend_from_slice(before);
    messages.push(ServerMessage::Joined(Joined {
        choice: StreamChoice::Within(Tolerance::NORMAL),
        config,
        start: stream.start(StreamId(0), Tick::ZERO),
        granted: granted(),
        extensions: Extensions::NONE,
    }));
    messages.extend(bodies);
    messages.push(ServerMessage::SnapshotEnd);
    messages
}

/// Hands messages of the server to a session.
fn receive(session: &mut ClientSession, messages: &[ServerMessage]) {
    let mut bytes = Vec::new();
    for message in messages {
        message.encode(&mut bytes);
    }
    session.handle_control(Instant::ZERO, SERVER, &bytes);
}

/// Hands messages of the server to a member; returns the events that the caller sees.
fn tell(
    session: &mut ClientSession,
    ids: &mut ClientIds,
    messages: &[ServerMessage],
) -> Vec<Event> {
    receive(session, messages);
    let mut seen = Vec::new();
    while let Some(event) = session.poll_event() {
        if ids.note(&event, session.replica()) {
            seen.push(event);
        }
    }
    seen
}

/// The session of a member of an empty scene that has sent everything.
fn member() -> ClientSession {
    let mut session = ClientSession::new("ids".parse().expect("a name"));
    session.handle_opened(Instant::ZERO, SERVER);
    receive(&mut session, &entry(&[], Vec::new()));
    assert!(session.replica().is_some(), "it is a member");
    while session.poll_transmit().is_some() {}
    while session.poll_event().is_some() {}
    session
}

/// The answer to all commands up to a number.
fn applied(through: u64) -> ServerMessage {
    let tick = Tick::ZERO;
    ServerMessage::Applied { through, tick }
}

fn ball(radius: f32) -> (BodyBuilder, BodyState) {
    let body = BodyDesc::dynamic(Shape::ball(radius));
    let state = body.state().expect("these numbers are finite");
    (body, state)
}

#[test]
fn bodies_of_which_one_finds_no_shape_number_are_all_left_out() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    // All numbers but one have another shape.
    for number in 1..SHAPES_MAX {
        let (id, shape) = (ShapeId(number), Shape::cuboid(1.0, 2.0, 3.0));
        let added = ids.command(&mut session, Command::AddShape { id, shape });
        added.expect("a member may add shapes");
    }
    while session.poll_transmit().is_some() {}
    let refused = ids.add_bodies(&mut session, &[ball(0.5), ball(0.25)]);
    assert_eq!(refused, Err(AddError::TooManyShapes));
    assert_eq!(session.poll_transmit(), None, "nothing is queued");
    assert_eq!(ids.missing_ids(GRANTED), 0, "no id is used");
    // One number is enough for two equal shapes.
    let before = ids.last_command().expect("shapes were added");
    let added = ids.add_bodies(&mut session, &[ball(0.5), ball(0.5)]);
    assert_eq!(added.map(|ids| ids.len()), Ok(2));
    assert_eq!(ids.last_command(), Some(before + 3), "a shape, two bodies");
    assert!(session.poll_transmit().is_some());
}

#[test]
fn bodies_of_which_one_finds_no_id_are_all_left_out() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    assert_eq!(ids.take_ids(GRANTED - 1).len(), GRANTED as usize - 1);
    let refused = ids.add_bodies(&mut session, &[ball(0.5), ball(0.5)]);
    assert!(matches!(refused, Err(AddError::Misuse(_))), "{refused:?}");
    assert_eq!(session.poll_transmit(), None, "nothing is queued");
    let (body, state) = ball(0.5);
    assert!(ids.add_body(&mut session, &body, state).is_ok());
}

#[test]
fn the_indices_of_refused_bodies_are_used_again_under_other_ids() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let (body, state) = ball(0.5);
    let mut given = BTreeSet::new();
    for _ in 0..3 * GRANTED {
        let id = ids.add_body(&mut session, &body, state).expect("an id");
        assert!(given.insert(id), "{id} was given before");
        let number = ids.last_command().expect("a body was added");
        let error = CommandError::TooManyBodies;
        let answers = [ServerMessage::Refused { number, error }, applied(number)];
        let seen = tell(&mut session, &mut ids, &answers);
        assert_eq!(seen[0], Event::Refused { number, error });
    }
    assert_eq!(ids.missing_ids(GRANTED), 0);
}

#[test]
fn the_id_of_a_refused_body_that_the_caller_chose_stays_the_callers() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let chosen = ids.take_ids(GRANTED);
    let (body, motion) = ball(0.5);
    let desc = body.desc(chosen[0], ShapeId(0));
    let added = ids.command(&mut session, Command::AddBody { desc, motion });
    let number = added.expect("a member may");
    let error = CommandError::UnknownShape(ShapeId(0));
    let answers = [ServerMessage::Refused { number, error }, applied(number)];
    tell(&mut session, &mut ids, &answers);
    assert_eq!(ids.take_ids(1), []);
}
