//! Arbitrary bytes of a peer do not affect others, and end with a code.
//!
//! A real server has well-behaved clients, which are real sessions compared with a parallel scene, and raw peers. The
//! raw peers send arbitrary bytes, damaged recordings of real sessions, and messages at the wrong time. Well-formed
//! commands with wrong numbers are tested in `refusals`.
//!
//! Caught so far: `Reserve` of zero indices took a range that others could have had; a session that had left still
//! reported what it missed.

use proptest::prelude::*;
use rhumb_protocol::limits::{
    COUNT_MAX, FEC_SPAN, HISTORY_PACKETS, INDICES_MAX, LOST_NUMBERS_MAX, RESERVE_MAX,
};
use rhumb_protocol::message::{ClientMessage, Extensions, StreamChoice};
use rhumb_protocol::packet::{LossReport, Low16, StreamId};
use rhumb_protocol::session::{ClientSession, CloseCode, Event};
use rhumb_protocol::{Endpoint, Instant, Peer, Span};
use rhumb_reckoning::{Divergence, Tick, Tolerance};
use rhumb_scene::Scene;
use rhumb_sims::{Script, Zoo};
use rhumb_tests::fuzzing::assert_peer_code;
use rhumb_tests::{Delivered, Dice, RawPeer, Table};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// A well-behaved client that leads a scene, and the parallel scene as truth.
struct Good {
    peer: Peer,
    script: Zoo,
    scene: Scene,
}

impl Good {
    fn new(table: &mut Table, name: &str) -> Self {
        let script = Zoo::new(12, 3);
        let scene = Scene::new(script.config()).expect("a valid configuration");
        let peer = table.create(name, script.config(), NORMAL);
        Self {
            peer,
            script,
            scene,
        }
    }

    /// Sends commands and steps; the copy must be complete and within tolerance regardless of other peers.
    fn tick(&mut self, table: &mut Table) {
        let mut commands = Vec::new();
        self.script.commands(self.scene.tick(), &mut commands);
        for command in &commands {
            self.scene.apply(command).expect("a valid command");
            table
                .session(self.peer)
                .command(command.clone())
                .expect("a member");
        }
        let tick = self.scene.step().expect("the engine steps").tick;
        let now = table.now();
        table
            .session(self.peer)
            .advance(now, tick)
            .expect("a member");
        table.run_until_idle();
        let session = table.session(self.peer);
        while let Some(event) = session.poll_event() {
            let bad = matches!(
                event,
                Event::Ended(_) | Event::Denied(_) | Event::Refused { .. }
            );
            assert!(!bad, "{event:?}");
        }
        let stream = session.replica().expect("a member").stream();
        assert_eq!(stream.complete(), tick);
        for desc in self.scene.bodies() {
            let truth = self.scene.observation(desc.id).expect("an existing body");
            let predicted_motion = stream
                .predicted_motion(desc.id, tick)
                .expect("the copy has the body");
            let radius = self
                .scene
                .bounding_radius(desc.id)
                .expect("a body has a shape");
            let apart =
                Divergence::between(&truth.motion.motion().pose(), &predicted_motion.pose());
            let share = Tolerance::NORMAL.share(&apart, radius);
            assert!(
                share <= 1.0,
                "{} has an error of {share} tolerances",
                desc.id
            );
        }
    }
}

/// All data that a real member sent and received in its life, in order.
fn conversation() -> (Vec<Delivered>, Vec<Delivered>) {
    let mut table = Table::default();
    let mut good = Good::new(&mut table, "recorded");
    for _ in 0..12 {
        good.tick(&mut table);
    }
    let session = table.session(good.peer);
    session.reserve(50).expect("a member");
    session.inspect().expect("a member");
    table.run_until_idle();
    table.pass(Span::from_millis(2_000));
    table.session(good.peer).leave().expect("a member");
    table.run_until_idle();
    (table.take_sent(good.peer), table.take_received(good.peer))
}

/// Damages sent data: changes bits, truncates, duplicates and reorders.
fn damage(delivered: &[Delivered], dice: &mut Dice) -> Vec<Delivered> {
    let mut damaged = delivered.to_vec();
    for _ in 0..1 + dice.below(4) {
        let place = dice.below(damaged.len());
        let other = dice.below(damaged.len());
        match dice.below(5) {
            0 => damaged.swap(place, other),
            1 => damaged.insert(other, damaged[place].clone()),
            2 => drop(damaged.remove(place)),
            _ => damaged[place] = corrupted(&damaged[place], dice),
        }
        if damaged.is_empty() {
            return delivered.to_vec();
        }
    }
    damaged
}

/// The same with one bit flipped, or truncated.
fn corrupted(delivered: &Delivered, dice: &mut Dice) -> Delivered {
    let turn = |bytes: &[u8], dice: &mut Dice| {
        let mut bytes = bytes.to_vec();
        if bytes.is_empty() || dice.below(4) == 0 {
            bytes.truncate(dice.below(bytes.len() + 1));
        } else {
            let bit = dice.below(bytes.len() * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
        bytes.into()
    };
    match delivered {
        Delivered::Control(bytes) => Delivered::Control(turn(bytes, dice)),
        Delivered::State(bytes) => Delivered::State(turn(bytes, dice)),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1_000))]

    #[test]
    fn arbitrary_bytes_close_their_sender_and_affect_no_other(
        pieces in proptest::collection::vec(
            (0_usize..3, any::<bool>(), proptest::collection::vec(any::<u8>(), 0..80)), 1..40)
    ) {
        let mut table = Table::default();
        let mut good = Good::new(&mut table, "good");
        let raw_peer = [table.connect_raw_peer(), table.connect_raw_peer(), RawPeer::enter(&mut table, "good").peer];
        for (place, (sender, control, bytes)) in pieces.iter().enumerate() {
            if *control {
                // A member may delete its scene or advance it, and two bytes suffice for that; such bytes are
                // replaced.
                let spared: Vec<u8> = bytes.iter().map(|byte| if [5, 8].contains(byte) { 0xff } else { *byte }).collect();
                table.control(raw_peer[*sender], &spared);
            } else {
                table.datagram(raw_peer[*sender], bytes);
            }
            if place % 8 == 0 {
                good.tick(&mut table);
            }
        }
        good.tick(&mut table);
        for peer in raw_peer {
            assert_peer_code(table.closed(peer));
        }
        prop_assert_eq!(table.closed(good.peer), None);
    }

    #[test]
    fn a_damaged_session_affects_no_other(seed: u64) {
        let (recorded, _) = RECORDED.with(Clone::clone);
        let mut dice = Dice::new(seed);
        let mut table = Table::default();
        let mut good = Good::new(&mut table, "good");
        let raw_peer = table.connect_raw_peer();
        for (place, delivered) in damage(&recorded, &mut dice).iter().enumerate() {
            match delivered {
                Delivered::Control(bytes) => table.control(raw_peer, bytes),
                Delivered::State(bytes) => table.datagram(raw_peer, bytes),
            }
            if place % 8 == 0 {
                good.tick(&mut table);
            }
        }
        good.tick(&mut table);
        assert_peer_code(table.closed(raw_peer));
        prop_assert_eq!(table.closed(good.peer), None);
    }

    #[test]
    fn a_closed_session_answers_nothing(lost: u64) {
        let (_, received) = RECORDED.with(Clone::clone);
        let mut session = ClientSession::new("recorded".parse().expect("a valid scene name"));
        let (now, later) = (Instant::ZERO, Instant::ZERO + Span::from_millis(900));
        session.handle_opened(now, Peer(0));
        let mut datagrams = 0_u32;
        let mut rest = Vec::new();
        for delivered in received {
            match delivered {
                // The last message ends the membership.
                Delivered::Control(bytes) if bytes[1] != LEFT => session.handle_control(now, Peer(0), &bytes),
                Delivered::Control(_) => {}
                Delivered::State(bytes) => {
                    datagrams += 1;
                    if lost >> (datagrams % 64) & 1 == 0 {
                        session.handle_datagram(now, Peer(0), &bytes);
                    } else {
                        rest.push(bytes);
                    }
                }
            }
        }
        session.close(CloseCode::DONE);
        while session.poll_event().is_some() {}
        while session.poll_transmit().is_some() {}
        for bytes in rest {
            session.handle_datagram(later, Peer(0), &bytes);
            prop_assert_eq!(session.poll_transmit(), None);
            prop_assert_eq!(session.poll_event(), None);
        }
    }

    #[test]
    fn a_damaged_session_never_makes_a_client_panic_or_grow(seed: u64) {
        let (_, received) = RECORDED.with(Clone::clone);
        let mut dice = Dice::new(seed);
        let mut session = ClientSession::new("recorded".parse().expect("a valid scene name"));
        let mut now = Instant::ZERO;
        session.handle_opened(now, Peer(0));
        for delivered in damage(&received, &mut dice) {
            now = now + Span::from_millis(5);
            match delivered {
                Delivered::Control(bytes) => session.handle_control(now, Peer(0), &bytes),
                Delivered::State(bytes) => session.handle_datagram(now, Peer(0), &bytes),
            }
            session.handle_timeout(now);
            while session.poll_event().is_some() {}
            let mut delivered = 0;
            while session.poll_transmit().is_some() {
                delivered += 1;
            }
            prop_assert!(delivered <= 3, "{} answers to one unit of data", delivered);
            let Some(stream) = session.replica().map(rhumb_protocol::session::Replica::stream) else {
                continue;
            };
            prop_assert!(stream.missing() <= HISTORY_PACKETS);
            prop_assert!(stream.index_end() <= INDICES_MAX as usize);
            for index in 0..stream.index_end().min(100) as u32 {
                let id = stream.body(index);
                let motion = id.and_then(|id| stream.predicted_motion(id, stream.watermark_tick()));
                prop_assert!(motion.is_none_or(|motion| motion.pose().position.is_finite()));
            }
        }
    }
}

/// The type of the message that ends a membership (PROTOCOL 4.3).
const LEFT: u8 = 5;

thread_local! {
    /// Recorded once per test thread.
    static RECORDED: (Vec<Delivered>, Vec<Delivered>) = conversation();
}

fn server_bytes(table: &mut Table, peer: Peer) -> usize {
    let delivered = table.take_received(peer);
    delivered
        .iter()
        .map(|delivered| match delivered {
            Delivered::Control(bytes) | Delivered::State(bytes) => bytes.len(),
        })
        .sum()
}

#[test]
fn a_message_longer_than_the_limit_is_refused_at_its_length() {
    let mut table = Table::default();
    let raw_peer = table.connect_raw_peer();
    // A length of 16,385 plus one byte for the type, as a varint.
    table.control(raw_peer, &[0x82, 0x80, 0x01]);
    assert_eq!(table.closed(raw_peer), Some(CloseCode::MALFORMED));
}

#[test]
fn each_wrong_beginning_has_its_code() {
    let hello = |versions: &[u16]| {
        let scene = "good".parse().unwrap();
        let versions = versions.to_vec();
        ClientMessage::Hello {
            versions,
            scene,
            extensions: Extensions::NONE,
        }
    };
    for (messages, code) in [
        (vec![ClientMessage::Leave], CloseCode::VIOLATION),
        (vec![hello(&[7])], CloseCode::VERSION),
        (vec![hello(&[1]), hello(&[1])], CloseCode::VIOLATION),
        (
            vec![hello(&[1]), ClientMessage::Inspect],
            CloseCode::VIOLATION,
        ),
    ] {
        let mut table = Table::default();
        let mut good = Good::new(&mut table, "good");
        let raw_peer = table.connect_raw_peer();
        let mut bytes = Vec::new();
        for message in &messages {
            message.encode(&mut bytes);
        }
        table.control(raw_peer, &bytes);
        assert_eq!(table.closed(raw_peer), Some(code), "{messages:?}");
        good.tick(&mut table);
    }
}

#[test]
fn a_loss_report_is_answered_by_no_more_than_it_names() {
    let mut table = Table::default();
    let mut good = Good::new(&mut table, "good");
    let raw_peer = RawPeer::enter(&mut table, "good");
    for _ in 0..20 {
        good.tick(&mut table);
    }
    table.take_received(raw_peer.peer);
    for stream in 0..4 {
        for lost in [0, 10, 60_000] {
            let loss_report = LossReport {
                next: Low16(lost),
                abandoned: Low16(lost),
                repair_symbols: FEC_SPAN as u8,
                lost: vec![Low16(lost); LOST_NUMBERS_MAX],
            };
            let bytes = loss_report.encode(StreamId(stream));
            table.datagram(raw_peer.peer, &bytes);
            let answers = table.take_received(raw_peer.peer).len();
            assert!(answers <= LOST_NUMBERS_MAX * 2 + 1, "{answers} answers");
        }
    }
    good.tick(&mut table);
}

#[test]
fn requests_cost_only_their_answers() {
    let mut table = Table::default();
    let mut good = Good::new(&mut table, "good");
    let raw_peer = RawPeer::enter(&mut table, "good");
    for message in [
        ClientMessage::Ping {
            sent: Instant::from_nanos(u64::MAX),
        },
        ClientMessage::Inspect,
        ClientMessage::Advance {
            to: Tick::new(COUNT_MAX),
        },
        ClientMessage::Reserve { count: RESERVE_MAX },
    ] {
        let mut bytes = Vec::new();
        message.encode(&mut bytes);
        for _ in 0..2_000 {
            table.control(raw_peer.peer, &bytes);
            assert!(server_bytes(&mut table, raw_peer.peer) < 120, "{message:?}");
        }
    }
    assert_eq!(raw_peer.closed(&table), None);
    good.tick(&mut table);
}

#[test]
fn a_reservation_of_nothing_takes_nothing() {
    let mut table = Table::default();
    let good = Good::new(&mut table, "good");
    let departed = RawPeer::enter(&mut table, "good");
    table.end(departed.peer);
    let mut raw_peer = RawPeer::enter(&mut table, "good");
    assert_eq!(
        raw_peer.granted, departed.granted,
        "free indices are granted again"
    );
    let leaver = RawPeer::enter(&mut table, "good");
    table.end(leaver.peer);
    raw_peer.send(&mut table, &ClientMessage::Reserve { count: 0 });
    assert_eq!(raw_peer.closed(&table), Some(CloseCode::MALFORMED));
    for granted in [raw_peer.granted, leaver.granted] {
        assert_eq!(RawPeer::enter(&mut table, "good").granted, granted);
    }
    assert_eq!(table.closed(good.peer), None);
}
