//! The scene continues, or ends, when a connection ends.
//!
//! Proved on a router of scenes without sockets. Caught: unread messages of a connection that had ended were handled without
//! any limit, thousands of joins among them; a client that came back was counted beside its own old connection
//! and lost its session; a provided scene that no client joined never ended.

use rhumb_protocol::message::{ClientMessage, Denial, SessionKey, SessionRequest, StreamChoice};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, IdRange, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span};
use rhumb_reckoning::{BodyState, Tolerance};
use rhumb_scene::{Limits, ProvidedScene, ProvidedScenes, SceneScript, SceneSettings};

use crate::links::{Links, create, join};

const LEADER: Peer = Peer(1);
const OTHER: Peer = Peer(2);

fn ball(granted: IdRange, place: u32) -> ClientMessage {
    let id = granted.id(place).expect("within the range");
    let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
    let at = [0.0, 2.0 * place as f32, 0.0];
    let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    let motion = motion.expect("these numbers are finite");
    ClientMessage::Command(Command::AddBody { desc, motion })
}

fn shape() -> ClientMessage {
    let (id, shape) = (ShapeId(0), Shape::ball(0.5));
    ClientMessage::Command(Command::AddShape { id, shape })
}

/// A lockstep scene with two members, and the range of the first one.
fn two_members() -> (Links, IdRange) {
    let mut links = Links::new();
    links.begin(LEADER, Stepping::Lockstep);
    links.connect(OTHER);
    links.send(OTHER, &[join()]);
    links.take(OTHER, usize::MAX);
    links.send(LEADER, &[shape()]);
    let granted = links.counts(LEADER).granted.expect("it has joined");
    (links, granted)
}

fn end(links: &mut Links, peer: Peer) {
    let now = links.now;
    links.server.handle_ended(now, peer, Ending::TimedOut);
    links.collect();
}

#[test]
fn commands_that_were_sent_before_the_end_are_applied() {
    let (mut links, granted) = two_members();
    let balls: Vec<_> = (0..20).map(|place| ball(granted, place)).collect();
    links.send(LEADER, &balls);
    end(&mut links, LEADER);
    assert_eq!(links.counts(OTHER).bodies, 20);
}

/// Two thousand joins behind a link that takes nothing made two thousand copies of the scene when it ended.
#[test]
fn nothing_is_done_behind_a_join_of_a_connection_that_has_ended() {
    let (mut links, granted) = two_members();
    let again = [ClientMessage::Leave, join()];
    let flood: Vec<_> = (0..2_000).flat_map(|_| again.clone()).collect();
    links.send(LEADER, &flood);
    links.send(LEADER, &[ball(granted, 0)]);
    end(&mut links, LEADER);
    assert_eq!(links.counts(OTHER).bodies, 0);
}

#[test]
fn a_client_that_comes_back_takes_the_place_of_its_old_connection() {
    let mut links = Links::with_limits(Limits {
        members_per_scene: 1,
        ..Limits::default()
    });
    let (key, answered) = (SessionKey([7; 16]), 0);
    let session = ClientMessage::Session(SessionRequest { key, answered });
    links.connect(LEADER);
    let enter = [create(Stepping::Lockstep), session.clone(), join()];
    links.send(LEADER, &enter);
    assert_eq!(links.counts(LEADER).resumed, Some(false));
    // The server does not know yet that the old connection is gone.
    links.connect(OTHER);
    links.send(OTHER, &[session, join()]);
    assert_eq!(links.counts(OTHER).denial, None);
    assert_eq!(links.counts(OTHER).resumed, Some(true));
    let taken = Some(CloseCode::SESSION_TAKEN.0);
    assert_eq!(links.counts(LEADER).closed, taken);
}

/// Its old connection has one of the streams that the client may have, and the new one asks for another stream.
#[test]
fn a_client_that_comes_back_takes_the_stream_of_its_old_connection() {
    let mut links = Links::new();
    let session = ClientMessage::Session(SessionRequest {
        key: SessionKey([7; 16]),
        answered: 0,
    });
    links.connect(LEADER);
    let enter = [create(Stepping::Lockstep), session.clone(), join()];
    links.send(LEADER, &enter);
    links.take(LEADER, usize::MAX);
    assert_eq!(links.counts(LEADER).resumed, Some(false));
    let within = |micrometres| {
        let tolerance = Tolerance::from_micrometres(micrometres).expect("within the range");
        ClientMessage::Join(StreamChoice::Within(tolerance))
    };
    let full = (10..100).map(Peer).find(|peer| {
        links.connect(*peer);
        links.send(*peer, &[within(10_000 + peer.0 as u32)]);
        links.counts(*peer).denial == Some(Denial::TooManyStreams)
    });
    assert!(full.is_some(), "the client has all its streams");
    links.connect(OTHER);
    links.send(OTHER, &[session, within(20_000)]);
    assert_eq!(links.counts(OTHER).denial, None);
    assert_eq!(links.counts(OTHER).resumed, Some(true));
}

#[test]
fn a_scene_that_is_created_and_never_joined_ends() {
    let mut links = Links::with(expiring());
    links.connect(LEADER);
    links.send(LEADER, &[create(Stepping::FreeRunning)]);
    assert_ends(links);
}

/// Settings of a server whose scenes end after ten seconds without members.
fn expiring() -> SceneSettings {
    SceneSettings {
        limits: Limits {
            empty_scene_seconds: 10,
            ..Limits::default()
        },
        ..SceneSettings::new(|| Instant::ZERO)
    }
}

/// Checks that the only scene ends when its only client is gone.
fn assert_ends(mut links: Links) {
    assert_eq!(links.server.scenes().count(), 1);
    end(&mut links, LEADER);
    links.pass(Span::from_millis(11_000));
    assert_eq!(links.server.scenes().count(), 0);
}

#[test]
fn a_provided_scene_that_no_client_joins_ends() {
    let provided = ProvidedScenes::new(|_| {
        Some(ProvidedScene {
            config: SceneConfig::default(),
            script: SceneScript::new(|_, _| {}),
        })
    });
    let mut links = Links::with(SceneSettings {
        provided: Some(provided),
        ..expiring()
    });
    links.connect(LEADER);
    assert_ends(links);
}

#[test]
fn a_member_of_a_driver_without_link_reports_may_be_silent_for_minutes() {
    let (mut links, granted) = two_members();
    for silence in [31, 100, 3_000] {
        links.take(LEADER, usize::MAX);
        links.pass(Span::from_millis(silence * 1_000));
        // Its answer, and an event that another member causes, begin to wait now.
        let pongs = links.counts(LEADER).pongs;
        links.send(LEADER, &[ClientMessage::Ping { sent: links.now }]);
        assert_eq!(links.counts(LEADER).pongs, pongs + 1);
        assert_eq!(links.counts(LEADER).closed, None, "after {silence} s");
    }
    // It does not read for longer than the limit.
    links.send(LEADER, &[ball(granted, 0)]);
    links.pass(Span::from_millis(31_000));
    links.send(LEADER, &[ball(granted, 1)]);
    assert!(links.counts(LEADER).closed.is_some());
}
