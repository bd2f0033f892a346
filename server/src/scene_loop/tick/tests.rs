//! Commands beyond the rate of a connection that ends.

use std::sync::Arc;

use rhumb_protocol::message::{
    Extensions, Frames, SceneEvent, ServerMessage, StreamChoice, VERSIONS,
};
use rhumb_protocol::scene::{SceneConfig, Shape, ShapeId};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint as _, Transmit};

use super::*;
use crate::permit::{Permit, Quotas};
use crate::settings::SceneSettings;

const HASTY: Peer = Peer(1);
const WATCHER: Peer = Peer(2);
/// Commands in a second.
const RATE: u32 = 10;
/// Commands that the hasty client sends at once.
const SENT: u32 = 100;

fn send(server: &mut SceneLoop, peer: Peer, messages: &[ClientMessage]) {
    let mut bytes = Vec::new();
    for message in messages {
        message.encode(&mut bytes);
    }
    server.handle_control(Instant::ZERO, peer, &bytes);
}

fn join(server: &mut SceneLoop, peer: Peer, permit: Permit) {
    server.handle_opened(Instant::ZERO, peer);
    server.admit(peer, Arc::new(permit));
    let hello = ClientMessage::Hello {
        versions: VERSIONS.to_vec(),
        scene: "rate".parse().unwrap(),
        extensions: Extensions::NONE,
    };
    let create = ClientMessage::Create(SceneConfig::default());
    let join = ClientMessage::Join(StreamChoice::Full);
    send(server, peer, &[hello, create, join]);
}

/// Commands of a client beyond its rate that are applied when its connection ends.
fn applied(ending: Ending) -> u32 {
    let settings = SceneSettings::new(|| Instant::ZERO).into();
    let mut server = SceneLoop::new("rate".parse().unwrap(), settings);
    join(&mut server, WATCHER, Permit::OPEN);
    let quotas = Quotas {
        commands: Some(RATE),
        ..Quotas::default()
    };
    let permit = Permit {
        quotas,
        ..Permit::OPEN
    };
    join(&mut server, HASTY, permit);
    let added = |id| {
        let shape = Shape::ball(0.5);
        ClientMessage::Command(Command::AddShape {
            id: ShapeId(id),
            shape,
        })
    };
    let commands: Vec<_> = (0..SENT).map(added).collect();
    send(&mut server, HASTY, &commands);
    server.handle_ended(Instant::ZERO, HASTY, ending);
    let (mut frames, mut count) = (Frames::default(), 0);
    while let Some(transmit) = server.poll_transmit() {
        if let Transmit::Control { to: WATCHER, bytes } = transmit {
            frames.push(&bytes);
        }
    }
    while let Some(framed) = frames.next_frame().unwrap() {
        let message = ServerMessage::decode(&framed).unwrap();
        count += u32::from(matches!(
            message,
            Some(ServerMessage::SceneEvent(SceneEvent::ShapeAdded { .. }))
        ));
    }
    count
}

#[test]
fn a_broken_connection_takes_no_command_beyond_its_rate_and_one_that_leaves_loses_none() {
    // A second of its rate, and the command that exceeds it.
    assert_eq!(applied(Ending::Broken), RATE + 1);
    assert_eq!(applied(Ending::TimedOut), RATE + 1);
    assert_eq!(applied(Ending::Closed(CloseCode::DONE.0)), SENT);
}
