//! Bodies are queued under new ids, with their shapes, all of a batch or none.
//!
//! Proved on the session of a member whose server is a few messages.

use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::message::{Extensions, Joined, ServerMessage, StreamChoice, VERSIONS, Welcome};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{BodyBuilder, BodyDesc, Command, IdRange, SceneConfig, Shape, ShapeId};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::{Features, StreamConfig};
use rhumb_protocol::{Endpoint as _, Instant, Peer};
use rhumb_reckoning::{BodyState, Tick, Tolerance};
use rhumb_view::{AddError, ClientIds};

/// Ids that the member has.
const GRANTED: u32 = 16;

fn granted() -> IdRange {
    IdRange::new(0, GRANTED, 0).expect("few ids")
}

/// The session of a member of an empty scene that has sent everything.
fn member() -> ClientSession {
    let config = SceneConfig::default();
    let stream = StreamConfig {
        tolerance: Tolerance::NORMAL,
        integrator: config.integrator,
        publish_interval: config.publish_schedule.publish_interval,
        gravity: config.gravity,
        largest_packet: LargestPacket::DEFAULT,
        features: Features::ALL,
    };
    let messages = [
        ServerMessage::Welcome(Welcome {
            version: VERSIONS[0],
            scene: Some(config),
            extensions: Extensions::NONE,
        }),
        ServerMessage::Joined(Joined {
            choice: StreamChoice::Within(Tolerance::NORMAL),
            config,
            start: stream.start(StreamId(0), Tick::ZERO),
            granted: granted(),
            extensions: Extensions::NONE,
        }),
        ServerMessage::SnapshotEnd,
    ];
    let mut bytes = Vec::new();
    for message in &messages {
        message.encode(&mut bytes);
    }
    let mut session = ClientSession::new("ids".parse().expect("a name"));
    let server = Peer(0);
    session.handle_opened(Instant::ZERO, server);
    session.handle_control(Instant::ZERO, server, &bytes);
    assert!(session.replica().is_some(), "it is a member");
    while session.poll_transmit().is_some() {}
    session
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
