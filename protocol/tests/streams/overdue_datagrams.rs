//! A client reports that an expected datagram has not arrived.
//!
//! A client session alone, with hand-made messages of a server. Caught so far: a client that had received nothing for a
//! while reported a lost answer to its advance only after three seconds, as if it had requested nothing.

use std::num::NonZeroU32;

use rhumb_protocol::message::{Extensions, Joined, ServerMessage, StreamChoice, Welcome};
use rhumb_protocol::packet::{LargestPacket, Low16, StreamId, Watermark};
use rhumb_protocol::scene::IdRange;
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::stream::StreamStart;
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit, WakeReason};
use rhumb_reckoning::{Tick, Tolerance};

use crate::terms::scene;

const PEER: Peer = Peer(0);

/// A member of a scene without bodies, directly after joining.
fn member(now: Instant) -> ClientSession {
    let mut session = ClientSession::new("pit".parse().expect("a name"));
    session.handle_opened(now, PEER);
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    let start = StreamStart {
        stream: StreamId(4),
        tolerance: choice.tolerance(),
        integrator: scene().integrator,
        publish_interval: NonZeroU32::MIN,
        largest_packet: LargestPacket::DEFAULT,
        gravity: scene().gravity,
        tick: Tick::ZERO,
        next: 0,
        scene_events: 0,
    };
    let welcome = ServerMessage::Welcome(Welcome {
        version: 1,
        scene: Some(scene()),
        extensions: Extensions::NONE,
    });
    let joined = ServerMessage::Joined(Joined {
        choice,
        config: scene(),
        start,
        granted: IdRange::EMPTY,
        extensions: Extensions::NONE,
    });
    let mut bytes = Vec::new();
    welcome.encode(&mut bytes);
    session.handle_control(now, PEER, &bytes);
    session.join(choice).expect("a welcomed client may join");
    bytes.clear();
    joined.encode(&mut bytes);
    ServerMessage::SnapshotEnd.encode(&mut bytes);
    session.handle_control(now, PEER, &bytes);
    while session.poll_transmit().is_some() {}
    session
}

/// The time of the session's next report of a possible loss, if nothing is received meanwhile.
fn next_report(session: &mut ClientSession, from: Instant) -> Instant {
    let mut now = from;
    loop {
        let wake = session.poll_timeout().expect("it waits for a tick");
        now = now.max(wake.at);
        session.handle_timeout(now);
        let sent: Vec<_> = std::iter::from_fn(|| session.poll_transmit()).collect();
        if wake.reason == WakeReason::Watermark {
            let is_state = |sent: &Transmit| matches!(sent, Transmit::State { .. });
            assert!(sent.iter().any(is_state), "{sent:?}");
            return now;
        }
    }
}

/// PROTOCOL 6.7-2: 100 ms after the request of a tick.
#[test]
fn a_lost_answer_to_an_advance_is_reported_after_a_tenth_of_a_second() {
    let mut session = member(Instant::ZERO);
    let requested = Instant::ZERO + Span::from_millis(1_500);
    session.handle_timeout(requested);
    session
        .advance(requested, Tick::new(1))
        .expect("a member may");
    while session.poll_transmit().is_some() {}
    assert_eq!(
        next_report(&mut session, requested),
        requested + Span::from_millis(100)
    );
}

/// PROTOCOL 6.7-2: twice the shorter of the last two response times, then doubling.
#[test]
fn retry_timer_follows_the_response_time() {
    let mut session = member(Instant::ZERO);
    let mut now = Instant::ZERO;
    for (tick, millis) in [(1, 90), (2, 200), (3, 160)] {
        session.advance(now, Tick::new(tick)).expect("a member may");
        now = now + Span::from_millis(millis);
        let watermark = Watermark {
            next: Low16(0),
            tick: Low16(tick as u16),
            scene_events: Low16(0),
        };
        session.handle_datagram(now, PEER, &watermark.encode(StreamId(4)));
        let copy = session.replica().expect("it is a member");
        assert_eq!(copy.stream().complete(), Tick::new(tick));
    }
    while session.poll_transmit().is_some() {}
    session.advance(now, Tick::new(4)).expect("a member may");
    for millis in [320, 640, 1_280, 2_000, 2_000] {
        let due = now + Span::from_millis(millis);
        now = next_report(&mut session, now);
        assert_eq!(now, due);
    }
}
