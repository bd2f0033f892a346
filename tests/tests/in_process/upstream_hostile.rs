//! A hostile upstream moves no body of another member.
//!
//! A well-behaved session publishes a body in a free-running scene. A raw peer, which has authority over another body,
//! sends arbitrary datagrams, damaged datagrams of a real publisher, and well-formed ones about bodies of others.

use proptest::prelude::*;
use rhumb_protocol::Peer;
use rhumb_protocol::message::{
    AuthorityError, AuthorityGrant, ClientMessage, ServerMessage, StreamChoice, TakeAuthority,
};
use rhumb_protocol::packet::{
    Keyframe, LargestPacket, Low16, RefreshRecord, RefreshWriter, StreamId, Update, UpdatePayload,
    UpdateWriter, Watermark,
};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, ShapeId, Stepping};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor, Tick, Ticks, Tolerance};
use rhumb_sims::Script;
use rhumb_tests::{Avatars, Delivered, Dice, RawPeer, TICK, Table};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

fn still(x: f32) -> BodyState {
    BodyState::new([x, 3.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a finite state")
}

/// A session that creates a scene of avatars.
fn create(table: &mut Table, name: &str, avatars: u32, stepping: Stepping) -> Peer {
    let mut script = Avatars(avatars);
    let config = SceneConfig {
        stepping,
        ..script.config()
    };
    let good = table.create(name, config, NORMAL);
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in commands {
        let session = table.session(good);
        session.command(command).expect("a member");
    }
    good
}

/// A raw peer that enters with a body of its own, which it takes authority over.
fn enter(table: &mut Table, name: &str) -> (RawPeer, BodyId, AuthorityGrant) {
    let mut raw_peer = RawPeer::enter(table, name);
    let own = raw_peer.granted.id(0).expect("a granted index");
    let desc = BodyDesc::plain(own, BodyKind::Kinematic, ShapeId(3));
    let motion = still(30.0);
    raw_peer
        .command(table, Command::AddBody { desc, motion })
        .expect("a member may add a body");
    let grant = take_authority(&mut raw_peer, table, own);
    (raw_peer, own, grant)
}

/// A free-running scene with a session that publishes the first avatar, and a raw peer with authority over its own
/// body.
struct Scene {
    table: Table,
    good: Peer,
    raw_peer: RawPeer,
    grant: AuthorityGrant,
    own: BodyId,
    ticks: u64,
}

impl Scene {
    fn new() -> Self {
        let mut table = Table::default();
        let good = create(&mut table, "driven", 1, Stepping::FreeRunning);
        table
            .session(good)
            .take_authority(Tolerance::NORMAL, &[Avatars::id(0)])
            .expect("a member");
        table.run_until_idle();
        let (raw_peer, own, grant) = enter(&mut table, "driven");
        Self {
            table,
            good,
            raw_peer,
            grant,
            own,
            ticks: 0,
        }
    }

    /// One tick of the scene: the session publishes its avatar, which must be where it was published.
    fn tick(&mut self) {
        self.ticks += 1;
        let id = Avatars::id(0);
        let tick = self.grant.tick + Ticks::new(self.ticks as u32 + 1);
        let walk = Avatars::walk(0, tick);
        let session = self.table.session(self.good);
        session
            .publish(tick, &[(id, walk)])
            .expect("it has authority");
        self.table.run_until_idle();
        self.table.pass(TICK);
        let session = self.table.session(self.good);
        while let Some(event) = session.poll_event() {
            let bad = matches!(
                event,
                Event::Ended(_) | Event::AuthorityDenied(_) | Event::BodyRemoved { .. }
            );
            assert!(!bad, "{event:?}");
        }
        let stream = session.replica().expect("a member").stream();
        let at = |id| {
            stream
                .predicted_motion(id, stream.watermark_tick())
                .expect("an existing body")
                .pose()
                .position
        };
        let off = at(id).distance(walk.motion().pose().position);
        assert!(off < 0.3, "the error of the avatar is {off} m");
        for (id, place) in [
            (
                Avatars::platform(),
                Avatars::platform_start().motion().pose().position,
            ),
            (Avatars::floor(), glam::DVec3::new(0.0, -0.5, 0.0)),
        ] {
            assert!(at(id).distance(place) < 0.06, "{id} is at {}", at(id));
        }
    }

    fn own(&mut self) -> glam::DVec3 {
        let stream = self
            .table
            .session(self.good)
            .replica()
            .expect("a member")
            .stream();
        stream
            .predicted_motion(self.own, stream.watermark_tick())
            .expect("an existing body")
            .pose()
            .position
    }

    /// A packet of the raw peer's own stream with these states, by index.
    fn state(&self, number: u64, tick: Tick, sent: &[(u32, BodyState)]) -> Vec<u8> {
        let mut writer = UpdateWriter::new(self.grant.stream, number, tick.value(), 0);
        for (index, motion) in sent {
            let payload = UpdatePayload::Keyframe(Keyframe {
                predictor: Predictor::Uniform,
                anchor: Anchor::Exact(*motion),
                parent: None,
            });
            let body = Some(*index);
            assert!(writer.push(&Update {
                alias: *index,
                body,
                payload
            }));
        }
        writer.finish(true)
    }
}

fn take_authority(raw_peer: &mut RawPeer, table: &mut Table, body: BodyId) -> AuthorityGrant {
    let drive = TakeAuthority {
        tolerance: Tolerance::NORMAL,
        largest_packet: LargestPacket::DEFAULT,
        bodies: vec![body],
    };
    let received = raw_peer.send(table, &ClientMessage::TakeAuthority(drive));
    let grant = received.into_iter().find_map(|message| match message {
        ServerMessage::AuthorityGrant(grant) => Some(grant),
        _ => None,
    });
    grant.expect("authority over its own body")
}

/// The datagrams that a well-behaved session publishes for a walk.
fn recorded(stream: StreamId) -> Vec<Vec<u8>> {
    let mut scene = Scene::new();
    scene.table.take_sent(scene.good);
    for _ in 0..60 {
        scene.tick();
    }
    let sent_data = scene.table.take_sent(scene.good);
    let mut packets: Vec<Vec<u8>> = sent_data
        .into_iter()
        .filter_map(|sent| match sent {
            Delivered::State(bytes) => Some(bytes.to_vec()),
            Delivered::Control(_) => None,
        })
        .collect();
    packets.iter_mut().for_each(|packet| rename(packet, stream));
    packets
}

/// Changes the stream id of a datagram; both ids fit into the first byte, above the kind.
fn rename(datagram: &mut [u8], stream: StreamId) {
    datagram[0] = datagram[0] & 15 | (stream.0 as u8) << 4;
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn arbitrary_datagrams_of_any_stream_move_no_other_body(
        pieces in proptest::collection::vec(
            (0_u8..10, 0_u8..6, proptest::collection::vec(any::<u8>(), 0..60)), 1..60)
    ) {
        let mut scene = Scene::new();
        for (place, (kind, stream, bytes)) in pieces.iter().enumerate() {
            let mut datagram = vec![*kind, *stream];
            datagram.extend_from_slice(bytes);
            scene.table.datagram(scene.raw_peer.peer, &datagram);
            if place % 8 == 0 {
                scene.tick();
            }
        }
        scene.tick();
        prop_assert_eq!(scene.raw_peer.closed(&scene.table), None);
    }

    #[test]
    fn a_damaged_upstream_moves_no_other_body(seed: u64) {
        let mut scene = Scene::new();
        let mut dice = Dice::new(seed);
        let packets = recorded(scene.grant.stream);
        for (place, packet) in packets.iter().enumerate() {
            let mut packet = packet.clone();
            if dice.below(3) == 0 {
                let bit = dice.below(packet.len() * 8);
                packet[bit / 8] ^= 1 << (bit % 8);
            }
            for _ in 0..dice.below(3) {
                scene.table.datagram(scene.raw_peer.peer, &packet);
            }
            if place % 4 == 0 {
                scene.tick();
            }
        }
        scene.tick();
        prop_assert_eq!(scene.raw_peer.closed(&scene.table), None);
    }
}

#[test]
fn an_upstream_moves_only_granted_bodies() {
    let mut scene = Scene::new();
    let tick = scene.grant.tick.next();
    // Index 0 is its own body; all other indices are invalid in its stream.
    for (number, index) in [(0, 0), (1, 1), (2, 4), (3, 511), (4, 512), (5, 1_000_000)] {
        let later = tick + Ticks::new(number as u32);
        let packet = scene.state(number, later, &[(index, still(33.0))]);
        scene.table.datagram(scene.raw_peer.peer, &packet);
    }
    for _ in 0..20 {
        scene.tick();
    }
    let own = scene.own();
    assert!((own.x - 33.0).abs() < 0.06, "it is at {own}");
}

#[test]
fn a_client_cannot_send_on_another_members_upstream() {
    let mut scene = Scene::new();
    scene.tick();
    for stream in StreamId::SMALL {
        if StreamId(stream) == scene.grant.stream {
            continue;
        }
        for number in 0..4 {
            let mut packet = scene.state(
                number,
                scene.grant.tick + Ticks::new(5),
                &[(0, still(-9.0))],
            );
            rename(&mut packet, StreamId(stream));
            scene.table.datagram(scene.raw_peer.peer, &packet);
        }
    }
    for _ in 0..20 {
        scene.tick();
    }
    let own = scene.own();
    assert!((own.x - 30.0).abs() < 0.06, "it is at {own}");
}

#[test]
fn impossible_places_and_ticks_leave_a_body_where_it_is() {
    let mut scene = Scene::new();
    let beyond = |x, v| BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [v; 3], [0.0; 3]);
    let tick = scene.grant.tick;
    for (number, (ahead, motion)) in [
        (1, beyond(1e30, 0.0)),
        (2, beyond(f32::MAX, f32::MAX)),
        (3, beyond(-1e6, 1e30)),
        (3_000, beyond(7.0, 0.0)),
        (6_000, beyond(7.0, 0.0)),
    ]
    .into_iter()
    .enumerate()
    {
        let motion = motion.expect("a finite state");
        let packet = scene.state(number as u64, tick + Ticks::new(ahead), &[(0, motion)]);
        scene.table.datagram(scene.raw_peer.peer, &packet);
        scene.tick();
        let own = scene.own();
        assert!((own.x - 30.0).abs() < 0.06, "it is at {own}");
    }
}

#[test]
fn a_tick_jump_ends_an_authority_which_can_be_taken_again() {
    let mut scene = Scene::new();
    let watermark = Watermark {
        next: Low16(0),
        tick: Low16::of(scene.grant.tick.value() + 20_000),
        scene_events: Low16(0),
    };
    scene.table.take_received(scene.raw_peer.peer);
    let datagram = watermark.encode(scene.grant.stream);
    scene.table.datagram(scene.raw_peer.peer, &datagram);
    let received = scene.table.take_received(scene.raw_peer.peer);
    assert!(
        matches!(&received[..], [Delivered::Control(_)]),
        "{received:?}"
    );
    // Later packets belong to a stream that has ended.
    for _ in 0..100 {
        scene.table.datagram(scene.raw_peer.peer, &datagram);
    }
    assert_eq!(scene.table.take_received(scene.raw_peer.peer), []);
    scene.grant = take_authority(&mut scene.raw_peer, &mut scene.table, scene.own);
    scene.ticks = 0;
    let packet = scene.state(0, scene.grant.tick.next(), &[(0, still(31.0))]);
    scene.table.datagram(scene.raw_peer.peer, &packet);
    for _ in 0..10 {
        scene.tick();
    }
    assert!((scene.own().x - 31.0).abs() < 0.06);
}

#[test]
fn endless_gaps_and_refreshes_of_packets_never_lost_cost_little() {
    let mut scene = Scene::new();
    let mut sent = 0;
    for round in 0..400_u64 {
        let tick = scene.grant.tick + Ticks::new(round as u32 + 1);
        let packet = scene.state(round * 2 + 1, tick, &[(0, still(30.0))]);
        scene.table.datagram(scene.raw_peer.peer, &packet);
        let mut writer = RefreshWriter::default();
        writer.push(&RefreshRecord {
            index: (round % 600) as u32,
            alias: Some((round * 7 % 600) as u32),
            age: Ticks::ZERO,
            keyframe: Keyframe {
                predictor: Predictor::Rest,
                anchor: Anchor::Exact(still(30.0)),
                parent: Some(BodyId::new(0, 0)).filter(|_| round % 3 == 0),
            },
        });
        let stream = scene.grant.stream;
        for datagram in writer.finish(stream, round * 3, tick.value(), 0) {
            scene.table.datagram(scene.raw_peer.peer, &datagram);
        }
        if round % 4 == 0 {
            scene.table.take_received(scene.raw_peer.peer);
            scene.tick();
            let received = scene.table.take_received(scene.raw_peer.peer);
            sent += received
                .iter()
                .filter(|sent| matches!(sent, Delivered::State(bytes) if bytes[0] & 15 == 6))
                .count();
        }
    }
    assert!(sent > 0 && sent <= 100, "{sent} loss reports in 100 ticks");
}

#[test]
fn authority_requests_cost_only_their_answers() {
    let mut scene = Scene::new();
    scene.tick();
    for _ in 0..2_000 {
        scene.grant = take_authority(&mut scene.raw_peer, &mut scene.table, scene.own);
    }
    let own = scene.own();
    assert!((own.x - 30.0).abs() < 0.06, "it is at {own}");
    let foreign = TakeAuthority {
        tolerance: Tolerance::NORMAL,
        largest_packet: LargestPacket::DEFAULT,
        bodies: vec![Avatars::id(0), scene.own],
    };
    for _ in 0..2_000 {
        let received = scene.raw_peer.send(
            &mut scene.table,
            &ClientMessage::TakeAuthority(foreign.clone()),
        );
        let refused = ServerMessage::AuthorityDenied(AuthorityError::NotYours(Avatars::id(0)));
        assert_eq!(received, [refused]);
    }
    assert_eq!(scene.raw_peer.closed(&scene.table), None);
    scene.tick();
}

#[test]
fn datagrams_in_the_wrong_direction_for_the_stepping_change_nothing() {
    let mut table = Table::default();
    let good = create(&mut table, "led", 0, Stepping::Lockstep);
    table.run_until_idle();
    let (mut raw_peer, own, grant) = enter(&mut table, "led");
    let mut writer = UpdateWriter::new(grant.stream, 0, 1, 0);
    let payload = UpdatePayload::Keyframe(Keyframe {
        predictor: Predictor::Rest,
        anchor: Anchor::Exact(still(35.0)),
        parent: None,
    });
    assert!(writer.push(&Update {
        alias: 0,
        body: Some(0),
        payload
    }));
    let packet = writer.finish(true);
    let step = |table: &mut Table, tick| {
        let now = table.now();
        table
            .session(good)
            .advance(now, Tick::new(tick))
            .expect("a member");
        table.run_until_idle();
        let stream = table.session(good).replica().expect("a member").stream();
        stream
            .predicted_motion(own, Tick::new(tick))
            .expect("an existing body")
            .pose()
            .position
            .x
    };
    // In a free-running scene the datagram would take effect a tick later; in lockstep it is ignored.
    table.datagram(raw_peer.peer, &packet);
    assert!((step(&mut table, 1) - 30.0).abs() < 0.06);
    raw_peer.send(&mut table, &ClientMessage::Upstream(packet));
    assert!((step(&mut table, 2) - 35.0).abs() < 0.06);
    let mut scene = Scene::new();
    let packet = scene.state(0, scene.grant.tick.next(), &[(0, still(35.0))]);
    let late = ClientMessage::Upstream(packet);
    scene.raw_peer.send(&mut scene.table, &late);
    for _ in 0..10 {
        scene.tick();
    }
    assert!((scene.own().x - 30.0).abs() < 0.06);
}
