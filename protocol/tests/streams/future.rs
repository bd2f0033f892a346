//! Messages of later versions are accepted or refused by their code.
//!
//! Shown on the bytes of a client's control stream; the tests of the server's side are in its session.

use glam::Vec3;
use rhumb_protocol::limits::GRANT;
use rhumb_protocol::message::{
    ClientMessage, Denial, Extension, Extensions, Frames, Joined, SceneEvent, ServerMessage,
    StreamChoice, VERSIONS, Welcome, frame, is_no_version,
};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{CommandError, IdRange};
use rhumb_protocol::session::{ClientSession, CloseCode, Event};
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Transmit};
use rhumb_reckoning::{Tick, Tolerance};

use crate::terms::scene;

const PEER: Peer = Peer(0);

fn extensions(id: u32) -> Extensions {
    let mut extensions = Extensions::NONE;
    let value = vec![1, 2, 3];
    assert!(extensions.insert(Extension { id, value }));
    extensions
}

fn welcome(version: u16, extensions: Extensions) -> ServerMessage {
    ServerMessage::Welcome(Welcome {
        version,
        scene: Some(scene()),
        extensions,
    })
}

fn joined(extensions: Extensions) -> ServerMessage {
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    let start = StreamStart {
        stream: StreamId(4),
        tolerance: choice.tolerance(),
        integrator: scene().integrator,
        publish_interval: scene().publish_schedule.publish_interval,
        largest_packet: LargestPacket::DEFAULT,
        gravity: Vec3::NEG_Y,
        tick: Tick::ZERO,
        next: 0,
        scene_events: 0,
    };
    ServerMessage::Joined(Joined {
        choice,
        config: scene(),
        start,
        granted: IdRange::EMPTY,
        extensions,
    })
}

fn receive(session: &mut ClientSession, messages: &[ServerMessage]) {
    let mut bytes = Vec::new();
    for message in messages {
        message.encode(&mut bytes);
    }
    session.handle_control(Instant::from_nanos(9), PEER, &bytes);
}

fn events(session: &mut ClientSession) -> Vec<Event> {
    std::iter::from_fn(|| session.poll_event()).collect()
}

fn opened(at: u64) -> ClientSession {
    let mut session = ClientSession::new("pit".parse().expect("a good name"));
    session.handle_opened(Instant::from_nanos(at), PEER);
    session
}

/// A session that is a member with a complete, empty replica.
fn member() -> ClientSession {
    let mut session = opened(0);
    receive(&mut session, &[welcome(1, Extensions::NONE)]);
    session
        .join(StreamChoice::Within(Tolerance::NORMAL))
        .expect("a client in the lobby may join");
    let snapshot = [joined(Extensions::NONE), ServerMessage::SnapshotEnd];
    receive(&mut session, &snapshot);
    assert!(matches!(
        events(&mut session)[..],
        [Event::Welcomed(_), Event::Joined(_)]
    ));
    session
}

fn sent_bytes(session: &mut ClientSession) -> Vec<u8> {
    let mut sent = Vec::new();
    while let Some(transmit) = session.poll_transmit() {
        if let Transmit::Control { bytes, .. } = transmit {
            sent.extend_from_slice(&bytes);
        }
    }
    sent
}

#[test]
fn a_hello_offers_the_known_version_and_a_reserved_one() {
    let mut places = [0; 2];
    for at in 0..64 {
        let mut frames = Frames::new();
        frames.push(&sent_bytes(&mut opened(at)));
        let first = frames
            .next_frame()
            .unwrap()
            .expect("a client sends a hello");
        let Ok(Some(ClientMessage::Hello {
            versions,
            extensions,
            ..
        })) = ClientMessage::decode(&first)
        else {
            panic!("a connection starts with a hello");
        };
        assert!(extensions.iter().count() == 1 && !extensions.has_unknown_critical());
        let place = versions.iter().position(|one| is_no_version(*one));
        places[place.expect("one version is reserved")] += 1;
        assert!(versions.contains(&VERSIONS[0]));
        while let Some(framed) = frames.next_frame().unwrap() {
            assert_eq!(ClientMessage::decode(&framed), Ok(None));
        }
    }
    assert!(places.iter().all(|count| *count > 16), "{places:?}");
}

#[test]
fn hellos_of_one_time_are_equal_and_of_two_differ() {
    assert_eq!(sent_bytes(&mut opened(5)), sent_bytes(&mut opened(5)));
    assert_ne!(sent_bytes(&mut opened(5)), sent_bytes(&mut opened(6)));
}

#[test]
fn a_welcome_in_an_unknown_version_ends_the_connection() {
    for version in [0, 2, 0x0a0a, 0xfafa, u16::MAX] {
        let mut session = opened(0);
        receive(&mut session, &[welcome(version, Extensions::NONE)]);
        let ended = Event::Ended(Ending::Closed(CloseCode::VERSION.0));
        assert_eq!(events(&mut session), [ended]);
    }
}

#[test]
fn an_unknown_extension_is_reported_and_a_critical_one_ends_the_connection() {
    let mut session = opened(0);
    receive(&mut session, &[welcome(1, extensions(27))]);
    assert!(matches!(
        &events(&mut session)[..],
        [Event::Welcomed(message)] if message.extensions == extensions(27)
    ));
    receive(&mut session, &[joined(extensions(9))]);
    assert_eq!(events(&mut session), []);
    let ended = Event::Ended(Ending::Closed(CloseCode::EXTENSION.0));
    let mut session = opened(0);
    receive(&mut session, &[welcome(1, extensions(26))]);
    assert_eq!(events(&mut session), std::slice::from_ref(&ended));
    let mut session = opened(0);
    receive(&mut session, &[welcome(1, Extensions::NONE)]);
    receive(&mut session, &[joined(extensions(2))]);
    assert_eq!(events(&mut session)[1..], [ended]);
}

#[test]
fn an_unknown_scene_event_changes_nothing_and_counts() {
    let mut session = member();
    let unknown = SceneEvent::Unknown {
        code: 0xff,
        fields: vec![9; 40],
    };
    receive(&mut session, &[ServerMessage::SceneEvent(unknown)]);
    assert_eq!(events(&mut session), []);
    // A watermark with one scene event is read at once; one with two is deferred.
    let watermark_tick =
        |session: &ClientSession| session.replica().unwrap().stream().watermark_tick();
    let watermark = |tick, scene_events| [0x42, 0, 0, tick, 0, scene_events, 0];
    session.handle_datagram(Instant::from_nanos(10), PEER, &watermark(3, 1));
    assert_eq!(watermark_tick(&session), Tick::new(3));
    session.handle_datagram(Instant::from_nanos(11), PEER, &watermark(5, 2));
    assert_eq!(watermark_tick(&session), Tick::new(3));
}

#[test]
fn unknown_messages_and_reasons_are_accepted() {
    let mut session = member();
    let mut bytes = Vec::new();
    frame(0x85, &[], &mut bytes);
    frame(0xff, &[3; 300], &mut bytes);
    session.handle_control(Instant::from_nanos(10), PEER, &bytes);
    assert_eq!(events(&mut session), []);
    let refused = ServerMessage::Refused {
        number: 0,
        error: CommandError::Other(0x90),
    };
    let denied = ServerMessage::Denied(Denial::Other(0x81));
    session.reserve(GRANT).unwrap();
    receive(&mut session, &[refused, denied]);
    let error = CommandError::Other(0x90);
    let expected = [
        Event::Refused { number: 0, error },
        Event::Denied(Denial::Other(0x81)),
    ];
    assert_eq!(events(&mut session), expected);
}

#[test]
fn a_member_whose_scene_moves_knows_where_to_go() {
    for (address, expected) in [
        ("rhumb://b:1", Some("rhumb://b:1")),
        ("", None),
        ("a b", None),
    ] {
        let mut session = member();
        let address = address.as_bytes().to_vec();
        receive(&mut session, &[ServerMessage::Moved { address }]);
        assert_eq!(session.elsewhere(), expected);
        assert_eq!(events(&mut session), []);
    }
}

#[test]
fn a_datagram_of_an_unknown_kind_is_dropped() {
    let mut session = member();
    // The low four bits are the kind, the others the stream.
    for head in (0..=u8::MAX).filter(|head| matches!(head & 15, 10 | 13..)) {
        session.handle_datagram(Instant::from_nanos(10), PEER, &[head, 1, 2, 3, 4, 5, 6]);
    }
    let stream = session.replica().unwrap().stream();
    assert!(stream.is_converged() && stream.watermark_tick() == Tick::ZERO);
    assert_eq!(events(&mut session), []);
}

#[test]
fn an_unknown_critical_message_is_malformed() {
    for (kind, body) in [(0x7f, &[][..]), (11, &[0x7f]), (8, &[0x7f]), (15, &[0x7f])] {
        let mut session = member();
        let mut bytes = Vec::new();
        frame(kind, body, &mut bytes);
        session.handle_control(Instant::from_nanos(10), PEER, &bytes);
        let ended = Event::Ended(Ending::Closed(CloseCode::MALFORMED.0));
        assert_eq!(events(&mut session), [ended], "{kind}");
    }
}
