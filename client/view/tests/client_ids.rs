//! Ids and shape numbers for the bodies of one client.
//!
//! Proved on the session of a member whose server is a few messages.

use std::collections::BTreeSet;

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, Joined, SceneEvent, ServerMessage, SessionKey, SessionState,
    StreamChoice, VERSIONS, Welcome,
};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, Command, CommandError, IdRange, SceneConfig, Shape, ShapeId,
};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::stream::{Features, StreamConfig};
use rhumb_protocol::{Ending, Endpoint as _, Instant, Peer, Transmit};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance, Track};
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
        if ids.note(&event, session) {
            seen.push(event);
        }
    }
    seen
}

/// The session of a member of an empty scene that has sent everything.
fn member() -> ClientSession {
    let mut session = ClientSession::new("ids".parse().expect("a name"));
    session.handle_opened(Instant::ZERO, SERVER);
    let welcome = entry(&[], Vec::new());
    receive(&mut session, &welcome[..1]);
    let begun = session.begin_session(SessionKey([1; 16]));
    begun.expect("it is in the lobby");
    receive(&mut session, &welcome[1..]);
    assert!(session.replica().is_some(), "it is a member");
    while session.poll_transmit().is_some() {}
    while session.poll_event().is_some() {}
    session
}

/// Ends a member's connection, and resumes its session over another one after so many commands were done; returns the
/// events that the caller sees. `bodies`: messages that place the bodies of the scene.
fn resume(
    session: &mut ClientSession,
    ids: &mut ClientIds,
    commands: u64,
    bodies: Vec<ServerMessage>,
) -> Vec<Event> {
    session.handle_ended(Instant::ZERO, SERVER, Ending::Broken);
    tell(session, ids, &[]);
    session.reconnect().expect("a member's session");
    session.handle_opened(Instant::ZERO, SERVER);
    let state = SessionState {
        resumed: true,
        durable: false,
        commands,
        tick: Tick::ZERO,
    };
    tell(
        session,
        ids,
        &entry(&[ServerMessage::Session(state)], bodies),
    )
}

/// Messages that place bodies of this shape at rest.
fn placed(placed: &[BodyId], shape: &Shape) -> Vec<ServerMessage> {
    let body = BodyDesc::dynamic(shape.clone());
    let motion = body.state().expect("these numbers are finite");
    let (id, shape) = (ShapeId(7), shape.clone());
    let place = |body_id: &BodyId| SceneEvent::BodyPlaced {
        desc: body.desc(*body_id, id),
        inertia: None,
        track: Track::resting(Tick::ZERO, motion),
        alias: None,
    };
    let shape = SceneEvent::ShapeAdded { id, shape };
    let events = std::iter::once(shape).chain(placed.iter().map(place));
    events.map(ServerMessage::SceneEvent).collect()
}

/// The commands that a session has sent since the last call.
fn sent(session: &mut ClientSession) -> Vec<Command> {
    let mut frames = Frames::new();
    while let Some(transmit) = session.poll_transmit() {
        if let Transmit::Control { bytes, .. } = transmit {
            frames.push(&bytes);
        }
    }
    let framed = std::iter::from_fn(|| frames.next_frame().expect("whole frames"));
    let messages = framed.map(|framed| ClientMessage::decode(&framed).expect("a message"));
    let commands = messages.filter_map(|message| match message {
        Some(ClientMessage::Command(command)) => Some(command),
        _ => None,
    });
    commands.collect()
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

#[test]
fn the_indices_of_bodies_that_went_while_no_connection_was_there_are_used_again() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let bodies = vec![ball(0.5); GRANTED as usize];
    let added = ids.add_bodies(&mut session, &bodies).expect("enough ids");
    let number = ids.last_command().expect("bodies were added");
    let (answered, lost) = added.split_at(GRANTED as usize / 2);
    // The server answers those of one half of the bodies before the connection breaks. Three bodies are left of each.
    let mut answers = placed(answered, &Shape::ball(0.5));
    answers.push(applied(number - lost.len() as u64));
    tell(&mut session, &mut ids, &answers);
    assert_ne!(ids.missing_ids(1), 0, "no id is left");
    let left: Vec<BodyId> = [&answered[..3], &lost[..3]].concat();
    let snapshot = placed(&left, &Shape::ball(0.5));
    let seen = resume(&mut session, &mut ids, number + 1, snapshot);
    assert!(matches!(seen[..], [Event::Resumed(_)]), "{seen:?}");
    tell(&mut session, &mut ids, &[applied(number)]);
    let free = ids.take_ids(2 * GRANTED);
    assert_eq!(free.len(), GRANTED as usize - left.len());
    let gone: BTreeSet<u32> = added
        .iter()
        .filter(|id| !left.contains(id))
        .map(|id| id.index())
        .collect();
    assert_eq!(
        free.iter().map(|id| id.index()).collect::<BTreeSet<_>>(),
        gone
    );
}

#[test]
fn the_id_of_a_body_whose_addition_is_sent_again_is_kept() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let bodies = vec![ball(0.5); GRANTED as usize];
    let added = ids.add_bodies(&mut session, &bodies).expect("enough ids");
    let number = ids.last_command().expect("bodies were added");
    resume(&mut session, &mut ids, 0, Vec::new());
    assert_eq!(ids.take_ids(1), []);
    let mut answers = placed(&added, &Shape::ball(0.5));
    answers.push(applied(number));
    tell(&mut session, &mut ids, &answers);
    assert_eq!(ids.take_ids(1), []);
}

/// Bodies whose shape is refused because another client has given its number to another shape, and the server's answer.
/// One body is still under way.
fn clash(session: &mut ClientSession, ids: &mut ClientIds) -> (Vec<BodyId>, Vec<Event>) {
    let (body, state) = ball(0.5);
    let added = [(); 2].map(|()| ids.add_body(session, &body, state));
    let added: Vec<BodyId> = added.into_iter().flatten().collect();
    let Some(Command::AddShape { id, .. }) = sent(session).into_iter().next() else {
        panic!("a new shape is sent first");
    };
    let shape = Shape::cuboid(1.0, 2.0, 3.0);
    let other = SceneEvent::ShapeAdded {
        id,
        shape: shape.clone(),
    };
    let desc = body.desc(added[0], id);
    let place = SceneEvent::BodyPlaced {
        desc,
        inertia: None,
        track: Track::resting(Tick::ZERO, state),
        alias: None,
    };
    let error = CommandError::ShapeIdTaken(id);
    let answers = [
        ServerMessage::SceneEvent(other),
        ServerMessage::Refused { number: 0, error },
        ServerMessage::SceneEvent(place),
        applied(1),
    ];
    let seen = tell(session, ids, &answers);
    (added, seen)
}

#[test]
fn bodies_whose_shape_number_another_client_took_first_get_their_shape() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let (added, seen) = clash(&mut session, &mut ids);
    let refused = |event: &Event| matches!(event, Event::Refused { .. });
    assert!(!seen.iter().any(refused), "{seen:?}");
    let mut sent_now = sent(&mut session).into_iter();
    let Some(Command::AddShape { id, shape }) = sent_now.next() else {
        panic!("the shape is added under another number");
    };
    assert_eq!(shape, Shape::ball(0.5));
    let changed: BTreeSet<BodyId> = sent_now
        .map(|command| match command {
            Command::ChangeBody { desc } if desc.shape == id => desc.id,
            other => panic!("{other:?}"),
        })
        .collect();
    assert_eq!(changed, added.iter().copied().collect());
    let (body, state) = ball(0.5);
    ids.add_body(&mut session, &body, state).expect("an id");
    let later = sent(&mut session);
    assert!(
        matches!(later[..], [Command::AddBody { desc, .. }] if desc.shape == id),
        "{later:?}"
    );
}

#[test]
fn a_body_that_cannot_get_its_shape_is_removed() {
    let (mut session, mut ids) = (member(), ClientIds::new(granted()));
    let (added, _) = clash(&mut session, &mut ids);
    let number = ids.last_command().expect("bodies are changed");
    let errors = [
        CommandError::UnderAuthority(added[0]),
        CommandError::UnknownBody(added[1]),
    ];
    sent(&mut session);
    let answers = (number - 1..).zip(errors);
    let mut answers: Vec<ServerMessage> = answers
        .map(|(number, error)| ServerMessage::Refused { number, error })
        .collect();
    answers.push(applied(number));
    let seen = tell(&mut session, &mut ids, &answers);
    assert!(matches!(seen[..], [Event::Applied { .. }]), "{seen:?}");
    assert_eq!(sent(&mut session), [Command::RemoveBody { id: added[0] }]);
}
