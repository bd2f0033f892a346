//! Commands act in the order of sending: a command after an advance, after it.
//!
//! Proved on a router of scenes without sockets that receives all messages in one read, as from a pipelined client.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, ResyncCause, ServerMessage, StreamChoice, VERSIONS,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Invalid, Material, Quantity, SceneConfig, Shape,
    ShapeId,
};
use rhumb_protocol::{Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::{BodyState, Tick, Tolerance};
use rhumb_scene::{SceneRouter, SceneSettings};

const CLIENT: Peer = Peer(1);

fn config() -> SceneConfig {
    SceneConfig {
        gravity: Vec3::NEG_Y,
        material: Material {
            friction: 0.2,
            restitution: 0.0,
            density: 1_000.0,
        },
        ..SceneConfig::default()
    }
}

fn shape(number: u32) -> ClientMessage {
    ClientMessage::Command(Command::AddShape {
        id: ShapeId(number),
        shape: Shape::Ball { radius: 0.5 },
    })
}

/// The server's messages in reply to messages that it receives in one read.
fn conversation(messages: &[ClientMessage]) -> Vec<ServerMessage> {
    let mut bytes = Vec::new();
    for message in messages {
        message.encode(&mut bytes);
    }
    replies_to(&bytes)
}

/// Feeds bytes in one read and runs until nothing is due; returns the messages on the control stream.
fn replies_to(bytes: &[u8]) -> Vec<ServerMessage> {
    let mut router = SceneRouter::new(SceneSettings::new(|| Instant::ZERO));
    let now = Instant::ZERO;
    router.handle_opened(now, CLIENT);
    router.handle_control(now, CLIENT, bytes);
    while router.poll_timeout().is_some() {
        router.handle_timeout(now);
    }
    let mut frames = Frames::new();
    while let Some(transmit) = router.poll_transmit() {
        if let Transmit::Control { bytes, .. } = transmit {
            frames.push(&bytes);
        }
    }
    let mut replies = Vec::new();
    while let Some(framed) = frames
        .next_frame()
        .expect("the server sends whole messages")
    {
        replies.extend(ServerMessage::decode(&framed).expect("the server follows the protocol"));
    }
    replies
}

/// The last command and the tick of each acknowledgement.
fn applied(replies: &[ServerMessage]) -> Vec<(u64, u64)> {
    let applied = replies.iter().filter_map(|message| match message {
        ServerMessage::Applied { through, tick } => Some((*through, tick.value())),
        _ => None,
    });
    applied.collect()
}

fn joined(rest: impl IntoIterator<Item = ClientMessage>) -> Vec<ClientMessage> {
    let mut messages = vec![
        ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: "order".parse().expect("a good name"),
            extensions: Extensions::NONE,
        },
        ClientMessage::Create(config()),
        ClientMessage::Join(StreamChoice::Within(Tolerance::NORMAL)),
    ];
    messages.extend(rest);
    messages
}

#[test]
fn a_command_after_an_advance_acts_after_its_steps() {
    let advance = |to| ClientMessage::Advance { to: Tick::new(to) };
    let replies = conversation(&joined([
        shape(0),
        advance(3),
        shape(1),
        shape(1),
        advance(5),
        shape(2),
    ]));
    assert_eq!(applied(&replies), [(0, 0), (2, 3), (3, 5)]);
    let refused =
        |message: &&ServerMessage| matches!(message, ServerMessage::Refused { number: 2, .. });
    assert_eq!(replies.iter().filter(refused).count(), 1);
}

#[test]
fn an_invalid_motion_is_refused_and_the_connection_stays() {
    let id = rhumb_reckoning::BodyId::new(0, 0);
    let motion = BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).unwrap();
    let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
    let mut bytes = Vec::new();
    for message in joined([shape(0)]) {
        message.encode(&mut bytes);
    }
    ClientMessage::Command(Command::AddBody { desc, motion }).encode(&mut bytes);
    // The position's last coordinate ends the message.
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    shape(1).encode(&mut bytes);
    let replies = replies_to(&bytes);
    let error = CommandError::Invalid(Invalid::not_finite(Quantity::Position));
    assert!(replies.contains(&ServerMessage::Refused { number: 1, error }));
    let tick = Tick::ZERO;
    assert!(replies.contains(&ServerMessage::Applied { through: 2, tick }));
}

#[test]
fn a_thousand_resyncs_in_one_read_get_one_snapshot() {
    let replies = conversation(&joined(std::iter::repeat_n(
        ClientMessage::Resync(ResyncCause::LostSync),
        1_000,
    )));
    let snapshots = replies
        .iter()
        .filter(|message| **message == ServerMessage::SnapshotEnd);
    assert_eq!(snapshots.count(), 2, "one for the join, one for the resync");
}

#[test]
fn commands_behind_an_advance_are_dropped_with_their_member() {
    let to = Tick::new(3);
    let again = ClientMessage::Join(StreamChoice::Full);
    let replies = conversation(&joined([
        ClientMessage::Advance { to },
        shape(0),
        ClientMessage::Leave,
        again,
        shape(1),
    ]));
    // The first command of the second membership; the earlier one was dropped with the first membership.
    assert_eq!(applied(&replies), [(0, 3)]);
}

/// PROTOCOL 4.2-2. Caught: the result of a command came after the answers to later messages.
#[test]
fn answers_keep_the_order_of_requests() {
    let replies = conversation(&joined([
        shape(0),
        ClientMessage::Ping {
            sent: Instant::from_nanos(7),
        },
        shape(1),
        ClientMessage::Reserve { count: 1 },
        shape(2),
        ClientMessage::Inspect,
        shape(3),
        ClientMessage::Leave,
    ]));
    let answers: Vec<_> = replies
        .iter()
        .filter_map(|message| match message {
            ServerMessage::Applied { through, .. } => Some(format!("applied {through}")),
            ServerMessage::Pong { .. } => Some("pong".to_owned()),
            ServerMessage::Reserved(_) => Some("reserved".to_owned()),
            ServerMessage::Inspection(_) => Some("inspection".to_owned()),
            ServerMessage::Left => Some("left".to_owned()),
            _ => None,
        })
        .collect();
    let expected = [
        "applied 0",
        "pong",
        "applied 1",
        "reserved",
        "applied 2",
        "inspection",
        "applied 3",
        "left",
    ];
    assert_eq!(answers, expected);
}
