//! The server accepts the bytes of the real plug-in and answers correctly.
//!
//! The tests play recordings of OpenSimulator's unmodified RemotePhysics plug-in (`PluginSession`) to a server in
//! virtual time: sessions with a region at rest, a region with a hundred balls and an avatar, forty balls, avatars
//! that walk, fly and are resized, and every other message of the plug-in.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::Vec3;
use rhumb_app::{AppOptions, Id, Kind, Logon, Message, Motion, States, TimeAdvanced};
use rhumb_protocol::Instant;
use rhumb_scene::SceneSettings;
use rhumb_scene::engine::Engines;
use rhumb_tests::{Dice, FailingEngine, PluginServer, PluginSession, Recording, falling, seed};

const ZOO: &[u8] = include_bytes!("../../data/app/harness_zoo.zst");
const BALLS: &[u8] = include_bytes!("../../data/app/harness_balls.zst");
const AVATAR: &[u8] = include_bytes!("../../data/app/harness_avatar.zst");
const REGION: &[u8] = include_bytes!("../../data/app/region_start.zst");
const REGION_BALLS: &[u8] = include_bytes!("../../data/app/region_balls_avatar.zst");

fn server() -> PluginServer {
    PluginServer::new(AppOptions::default())
}

/// Plays a recording to its end, message by message, and checks the common properties of all sessions.
fn play(packed: &[u8]) -> (Recording, PluginSession) {
    let recording = Recording::unpack(packed);
    let mut server = server();
    let mut session = PluginSession::begin(&mut server, 1, recording.datagram());
    let steps = recording.count(Kind::AdvanceTime);
    for piece in recording.pieces() {
        assert!(!session.closed, "closed before {piece:?}");
        session.send(&mut server, piece);
    }
    assert!(session.closed, "a client that logs off is disconnected");
    assert!(!server.has_scene(7), "the scene ends with its client");
    assert_eq!(session.received(Kind::LogonReady), 1);
    assert_eq!(session.received(Kind::TimeAdvanced), steps);
    let refused: Vec<_> = session
        .tcp_messages
        .iter()
        .filter(|message| message.kind() == Kind::Error)
        .collect();
    assert!(refused.is_empty(), "{refused:?}");
    (recording, session)
}

/// Height of the harness's terrain: four plateaus, with steps in the middle.
fn plateau(size: f32, x: f32, y: f32) -> f32 {
    let middle = size * 0.5;
    match (x >= middle, y >= middle) {
        (false, false) => 20.0,
        (true, false) => 26.0,
        (false, true) => 22.0,
        (true, true) => 28.0,
    }
}

#[test]
fn a_region_that_starts_and_stops_is_accepted() {
    let (recording, session) = play(REGION);
    assert_eq!(recording.count(Kind::AddHeightField), 2);
    assert_eq!(session.received(Kind::SetDynamicActor), 0, "no body moves");
}

#[test]
fn forty_balls_come_to_rest_on_their_plateaus() {
    let (recording, session) = play(BALLS);
    assert_eq!(
        session.received(Kind::UpdateMass),
        recording.count(Kind::GetMass)
    );
    let last = session.last_states();
    assert_eq!(last.len(), 40);
    for (name, state) in last {
        let above = state.position.z - plateau(64.0, state.position.x, state.position.y);
        assert!(
            (0.2..0.3).contains(&above),
            "{name}: {state:?} is {above} m above"
        );
    }
}

/// Position of an actor in the last state up to the end of a frame.
fn at(track: &BTreeMap<usize, Motion>, frame: usize) -> Vec3 {
    let last = track.range(..=frame).next_back();
    last.expect("a state up to that frame").1.position
}

/// The masses reported for an actor, in order, in kg.
fn masses(session: &PluginSession, actor: u32) -> Vec<f32> {
    let reported = session
        .tcp_messages
        .iter()
        .filter_map(|message| match message {
            Message::UpdateMass((id, mass)) if id.object == actor => Some(*mass),
            _ => None,
        });
    reported.collect()
}

#[test]
fn every_kind_of_object_is_accepted_and_its_mass_reported() {
    let (recording, session) = play(ZOO);
    assert_eq!(
        recording.count(Kind::ApplyTorque),
        1,
        "the message without a header"
    );
    // From edges, radius and density, as the harness requested them. A mass is reported on request, and again when it
    // changes.
    let ball = core::f32::consts::PI / 6.0;
    let expected: [(u32, &[f32]); 5] = [
        // A box that is enlarged, then made static and dynamic again.
        (720_001, &[1e3, 4e3, 4e3, 4e3]),
        // A wall of 4 m × 0.5 m × 2 m that does not change.
        (720_002, &[4e3, 4e3, 4e3]),
        // A ball whose material changes.
        (720_003, &[ball * 1e3, ball * 7.7e3]),
        // An actor whose attached shape is undefined.
        (720_004, &[1.0]),
        // A cube with two linked cubes, one of which is removed.
        (720_010, &[1e3, 3e3, 2e3]),
    ];
    for (actor, expected) in expected {
        let reported = masses(&session, actor);
        let is_as = |(reported, expected): (&f32, &f32)| (reported / expected - 1.0).abs() < 1e-4;
        let all = reported.len() == expected.len() && reported.iter().zip(expected).all(is_as);
        assert!(all, "{actor}: {reported:?} kg, not {expected:?}");
    }
    for (_, state) in &session.states {
        assert!(state.position.is_finite() && state.rotation.is_normalized());
    }
}

#[test]
fn a_body_moves_with_the_velocity_that_is_set() {
    let (_, session) = play(ZOO);
    // After frame 34 the velocity is set to 1 m/s along x and 3 m/s up, so the ball rises for a third of a second.
    let ball = session.track(720_003);
    let top = (35..40).map(|frame| at(&ball, frame).z).fold(0.0, f32::max);
    let rise = top - at(&ball, 34).z;
    assert!((0.35..0.46).contains(&rise), "it rose by {rise} m");
    let way = at(&ball, 38) - at(&ball, 34);
    assert!((way.x - 4.0 * 0.089).abs() < 0.02, "it moved by {way}");
    assert!(way.y.abs() < 0.01, "it moved by {way}");
    // Before frame 65 a box of 1 m is placed at a height of 28 m, over ground at 20 m.
    let fallen = session.track(720_001);
    assert!(at(&fallen, 66).z > 27.5, "{:?}", at(&fallen, 66));
    assert!(
        (at(&fallen, 80).z - 20.5).abs() < 0.02,
        "{:?}",
        at(&fallen, 80)
    );
}

#[test]
fn avatars_stay_upright_on_the_ground_and_report_contacts() {
    let (_, session) = play(AVATAR);
    let mut felt = 0;
    for message in session
        .datagram_messages
        .iter()
        .chain(&session.tcp_messages)
    {
        match message {
            Message::SetDynamicActor(state) => {
                let turned = (state.rotation * Vec3::Z).z;
                assert!(turned > 0.999, "{state:?} leans");
                assert!(state.position.z > 20.0, "{state:?} is under the ground");
            }
            Message::ActorsCollided(contact) => {
                assert!(contact.colliding.object >= 800_000, "{contact:?}");
                assert!(contact.normal.is_normalized());
                felt += u32::from(contact.collided.object == 1 && contact.normal.z > 0.9);
            }
            _ => {}
        }
    }
    assert!(felt > 50, "{felt} contacts with the ground were reported");
}

#[test]
fn an_avatar_walks_flies_and_lands_as_commanded() {
    let (_, session) = play(AVATAR);
    let track = session.track(800_001);
    let at = |frame| at(&track, frame);
    // 1.9 m tall, on ground at 20 m.
    let stands = |frame: usize| (at(frame).z - 20.95).abs() < 0.03;
    assert!(stands(30) && at(30).distance(at(34)) < 0.01, "{}", at(34));
    // From frame 35 on its target velocity is 2 m/s along x; friction slows it between two such messages.
    let walked = at(42) - at(34);
    let requested_authority = 8.0 * 0.089 * 2.0;
    assert!(
        (0.7 * requested_authority..=requested_authority).contains(&walked.x),
        "{walked}"
    );
    assert!(walked.y.abs() < 0.01 && stands(42), "{walked}");
    // A step of 6 m stops it after three metres.
    assert!((62.0..63.5).contains(&at(62).x), "{}", at(62));
    // From frame 70 to 81 it has no weight, and its velocity is 1 m/s upwards.
    let risen = at(81).z - at(69).z;
    assert!((0.9..1.1).contains(&risen), "it rose by {risen} m");
    assert!(stands(69) && stands(104), "{} {}", at(69), at(104));
}

#[test]
fn a_region_with_balls_and_an_avatar_is_accepted_to_its_end() {
    let (recording, session) = play(REGION_BALLS);
    assert!(recording.messages.len() > 2_600);
    let last = session.last_states();
    assert!(last.len() >= 100, "{} moved", last.len());
    assert!(session.received(Kind::UpdateMass) >= recording.count(Kind::GetMass));
    // The last terrain is above the balls that rest on the first, so they are moved onto it. Some roll over the edge.
    let inside = |state: &Motion| {
        let region = 0.0..255.0;
        region.contains(&state.position.x) && region.contains(&state.position.y)
    };
    for (name, state) in last.iter().filter(|(_, state)| inside(state)) {
        assert!(
            state.position.z > 24.1,
            "{name} is under the ground: {state:?}"
        );
    }
    assert!(last.values().filter(|state| inside(state)).count() >= 95);
}

/// The last reported position of each actor.
fn last_places(messages: &[Message]) -> BTreeMap<u32, Vec3> {
    let states = messages.iter().filter_map(|message| match message {
        Message::SetDynamicActor(state) => Some((state.actor.object, state.position)),
        _ => None,
    });
    states.collect()
}

#[test]
fn resting_states_are_repeated_on_the_reliable_connection() {
    let (_, session) = play(BALLS);
    let (datagram_messages, tcp_messages) = (
        last_places(&session.datagram_messages),
        last_places(&session.tcp_messages),
    );
    assert_eq!(
        tcp_messages.len(),
        40,
        "every ball came to rest at least once"
    );
    let same = datagram_messages
        .iter()
        .filter(|(name, at)| tcp_messages[name].distance(**at) < 2e-3);
    assert!(same.count() >= 35, "{datagram_messages:?} {tcp_messages:?}");
}

#[test]
fn simulations_of_several_clients_do_not_touch() {
    let (balls, zoo) = (Recording::unpack(BALLS), Recording::unpack(ZOO));
    let (_, alone) = play(BALLS);
    let mut server = server();
    let mut first = PluginSession::begin(&mut server, 1, balls.datagram());
    // The same session with another simulation number.
    let mut logon = Vec::new();
    Message::Logon(Logon::new(8, "other")).encode(0, &mut logon);
    let mut second = PluginSession::begin(&mut server, 2, &logon);
    second.send(&mut server, &logon);
    let mut others = zoo.pieces().skip(1);
    for piece in balls.pieces() {
        first.send(&mut server, piece);
        for piece in others.by_ref().take(2) {
            second.send(&mut server, piece);
        }
    }
    assert_eq!(first.last_states(), alone.last_states());
    for state in second.last_states().values() {
        assert_eq!(state.actor.simulation, 8);
    }
    assert!(second.received(Kind::UpdateMass) >= 11);
}

#[test]
fn a_second_client_of_a_simulation_is_refused_and_the_first_continues() {
    let recording = Recording::unpack(ZOO);
    let mut server = server();
    let mut first = PluginSession::begin(&mut server, 1, recording.datagram());
    let half = recording.bytes.len() / 2;
    first.send(&mut server, &recording.bytes[..half]);
    let mut second = PluginSession::begin(&mut server, 2, recording.datagram());
    second.send(&mut server, &recording.bytes);
    assert!(second.closed && second.tcp_messages.is_empty());
    second.end(&mut server);
    first.send(&mut server, &recording.bytes[half..]);
    assert!(first.closed);
    let frames = recording.count(Kind::AdvanceTime);
    assert_eq!(first.received(Kind::TimeAdvanced), frames);
}

#[test]
fn messages_of_a_rejected_peer_are_ignored() {
    let (mut logon, mut frame) = (Vec::new(), Vec::new());
    Message::Logon(Logon::new(7, "one")).encode(0, &mut logon);
    Message::AdvanceTime((7, 0.089)).encode(0, &mut frame);
    let mut server = server();
    let mut first = PluginSession::begin(&mut server, 1, &logon);
    first.send(&mut server, &logon);
    let mut second = PluginSession::begin(&mut server, 2, &logon);
    second.send(&mut server, &logon);
    assert!(second.closed);
    // Its connection is not closed yet, and it continues to send.
    second.send(&mut server, &frame);
    assert!(!server.has_scene(7));
    first.send(&mut server, &frame);
    second.send(&mut server, &frame);
    second.end(&mut server);
    assert!(second.tcp_messages.is_empty() && second.datagram_messages.is_empty());
    assert!(server.has_scene(7));
    assert_eq!(first.received(Kind::TimeAdvanced), 1);
}

#[test]
fn an_engine_fault_closes_the_owning_client_which_may_return() {
    let (mut logon, mut frame) = (Vec::new(), Vec::new());
    Message::Logon(Logon::new(7, "x")).encode(0, &mut logon);
    Message::AdvanceTime((7, 0.089)).encode(0, &mut frame);
    let failing = FailingEngine::engines_that_fail_after(Some(6));
    let is_first = AtomicBool::new(true);
    // Only the first scene's engine fails.
    let engines =
        Engines::new(
            move |config, threads| match is_first.swap(false, Ordering::Relaxed) {
                true => failing.make(config, threads),
                false => Engines::default().make(config, threads),
            },
        );
    let settings = SceneSettings {
        engines,
        ..SceneSettings::new(|| Instant::ZERO)
    };
    let mut server = PluginServer::with(AppOptions::default(), settings);
    let mut first = PluginSession::begin(&mut server, 1, &logon);
    first.send(&mut server, &logon);
    first.send(&mut server, &frame);
    assert!(!first.closed);
    first.send(&mut server, &frame);
    assert!(first.closed);
    assert!(!server.has_scene(7));
    // The old connection is still closing when the client comes again.
    let mut second = PluginSession::begin(&mut server, 2, &logon);
    second.send(&mut server, &logon);
    second.send(&mut server, &frame);
    second.send(&mut server, &frame);
    assert!(!second.closed);
    assert!(server.has_scene(7));
}

#[test]
fn a_client_whose_datagram_is_lost_receives_its_states_on_tcp() {
    let recording = Recording::unpack(BALLS);
    let mut server = server();
    let mut session = PluginSession::begin(&mut server, 1, b"no logon");
    for piece in recording.pieces() {
        session.send(&mut server, piece);
    }
    assert!(session.datagram_messages.is_empty());
    assert_eq!(session.last_states().len(), 40);
}

#[test]
fn when_tcp_is_too_slow_for_all_states_every_body_is_served_in_turn() {
    const BODIES: u32 = 1_000;
    const FRAMES: usize = 40;
    // Bytes that the connection accepts between two frames of a plug-in: 16 KiB in 35 ms.
    const TAKEN_BYTES: usize = (16 << 10) * 89 / 35;
    let mut server = server();
    let mut session = PluginSession::begin(&mut server, 1, b"no logon");
    session.send(&mut server, &falling(7, BODIES));
    let mut frame = Vec::new();
    Message::AdvanceTime((7, 0.089)).encode(0, &mut frame);
    for _ in 0..FRAMES {
        let before = session.stream_bytes;
        session.send(&mut server, &frame);
        let waiting = session.waiting_bytes + session.stream_bytes - before;
        assert!(waiting < 70_000, "{waiting} bytes are queued");
        session.waiting_bytes = waiting.saturating_sub(TAKEN_BYTES);
    }
    assert_eq!(session.received(Kind::TimeAdvanced), FRAMES);
    for ball in 1_000..1_000 + BODIES {
        let reported: Vec<usize> = session.track(ball).into_keys().collect();
        let silent = reported.windows(2).map(|two| two[1] - two[0]).max();
        assert!(
            silent.is_some_and(|frames| frames <= 3),
            "{ball}: {reported:?}"
        );
        let last = reported.last().copied();
        assert!(
            last.is_some_and(|last| last + 3 > FRAMES),
            "{ball}: {reported:?}"
        );
    }
}

#[test]
fn resting_states_are_sent_after_a_blocked_connection_recovers() {
    let recording = Recording::unpack(BALLS);
    let mut server = server();
    let mut session = PluginSession::begin(&mut server, 1, b"no logon");
    session.waiting_bytes = 1 << 20;
    // Everything except the end of the recording, where the ground is removed.
    for (piece, message) in recording.pieces().zip(&recording.messages) {
        if message.kind() == Kind::DetachShape {
            break;
        }
        session.send(&mut server, piece);
    }
    assert!(session.states.is_empty());
    let frames = recording.count(Kind::AdvanceTime);
    assert_eq!(session.received(Kind::TimeAdvanced), frames);
    session.waiting_bytes = 0;
    let mut frame = Vec::new();
    Message::AdvanceTime((7, 0.089)).encode(0, &mut frame);
    session.send(&mut server, &frame);
    let last = session.last_states();
    assert_eq!(last.len(), 40);
    for state in last.values() {
        let above = state.position.z - plateau(64.0, state.position.x, state.position.y);
        assert!((0.2..0.3).contains(&above), "{state:?}");
    }
}

#[test]
fn an_operator_selects_the_states_that_are_sent() {
    let recording = Recording::unpack(BALLS);
    let play = |options: AppOptions| {
        let mut server = PluginServer::new(options);
        let mut session = PluginSession::begin(&mut server, 1, recording.datagram());
        for piece in recording.pieces() {
            session.send(&mut server, piece);
        }
        session
    };
    let frames = recording.count(Kind::AdvanceTime);
    let all = play(AppOptions {
        states: States::All,
        time_advanced: TimeAdvanced::Udp,
        ..AppOptions::default()
    });
    let over = |messages: &[Message]| {
        let over = messages.iter().filter(|m| m.kind() == Kind::TimeAdvanced);
        over.count()
    };
    assert_eq!(
        (over(&all.datagram_messages), over(&all.tcp_messages)),
        (frames, 0)
    );
    let never = play(AppOptions {
        states: States::Active,
        time_advanced: TimeAdvanced::Never,
        ..AppOptions::default()
    });
    assert_eq!(never.received(Kind::TimeAdvanced), 0);
    let changed = play(AppOptions::default());
    let count = |session: &PluginSession| session.received(Kind::SetDynamicActor);
    assert!(count(&changed) < count(&never) && count(&never) <= count(&all));
}

#[test]
fn broken_sessions_end_without_a_panic_and_without_effect_on_others() {
    let (zoo, balls) = (Recording::unpack(ZOO), Recording::unpack(BALLS));
    let mut dice = Dice::new(seed(0xa99));
    let mut server = server();
    let mut logon = Vec::new();
    Message::Logon(Logon::new(99, "steady")).encode(0, &mut logon);
    let mut steady = PluginSession::begin(&mut server, 1, &logon);
    steady.send(&mut server, &logon);
    let mut closed = 0;
    for round in 0..60_u16 {
        let of = if round % 2 == 0 { &zoo } else { &balls };
        let mut bytes = of.bytes.clone();
        // The part after the terrain, which has most of the messages.
        let words = bytes.len() - 17_000;
        for _ in 0..1 + dice.below(20) {
            let place = words + dice.below(17_000);
            bytes[place] = dice.below(256) as u8;
        }
        let mut broken = PluginSession::begin(&mut server, 2 + round, &bytes);
        for piece in bytes.chunks(1 + dice.below(3_000)) {
            broken.send(&mut server, piece);
            if broken.closed {
                break;
            }
        }
        closed += u32::from(broken.closed);
        broken.end(&mut server);
        let mut frame = Vec::new();
        Message::AdvanceTime((99, 0.089)).encode(0, &mut frame);
        steady.send(&mut server, &frame);
        assert_eq!(steady.received(Kind::TimeAdvanced), usize::from(round) + 1);
        assert!(
            server.has_scene(99) && !server.has_scene(7),
            "a scene ends with its client"
        );
    }
    assert!(closed > 20, "only {closed} of 60 sessions were closed");
}

#[test]
fn invalid_numbers_are_refused_and_the_session_continues() {
    let mut server = server();
    let mut bytes = Vec::new();
    let id = |object| Id {
        simulation: 7,
        object,
    };
    let wrong = [
        Message::AddSphere((id(1), Vec3::ZERO, f32::NAN)),
        Message::AddSphere((id(1), Vec3::NAN, 1.0)),
        Message::AddBox((id(1), Vec3::new(1.0, -1.0, 1.0))),
        Message::AddCapsule((id(1), 1e9, 1.0)),
        Message::AddPlane((id(1), 0.0, Vec3::ZERO)),
        Message::UpdateGravityModifier((id(1), f32::INFINITY)),
        Message::UpdateLinearVelocity((id(1), Vec3::splat(1e30))),
        Message::UpdateActorOrientation((id(1), glam::Quat::from_xyzw(0.0, 0.0, 0.0, 0.0))),
        Message::UpdateActorPosition((id(1), Vec3::NEG_INFINITY)),
        Message::AdvanceTime((7, f32::NAN)),
        Message::AdvanceTime((7, -1.0)),
    ];
    Message::Logon(Logon::new(7, "x")).encode(0, &mut bytes);
    for (index, message) in wrong.iter().enumerate() {
        message.encode(index as u32 + 1, &mut bytes);
    }
    Message::AdvanceTime((7, 0.089)).encode(99, &mut bytes);
    let mut session = PluginSession::begin(&mut server, 1, b"");
    session.send(&mut server, &bytes);
    assert!(!session.closed);
    let refused: Vec<u32> = session
        .tcp_messages
        .iter()
        .filter_map(|message| match message {
            Message::Error(fault) => Some(fault.index),
            _ => None,
        })
        .collect();
    assert_eq!(refused, (1..=wrong.len() as u32).collect::<Vec<_>>());
    assert_eq!(session.received(Kind::TimeAdvanced), 1);
}

#[test]
fn the_plug_in_receives_the_same_bytes_as_from_scenes_without_a_gateway() {
    // Of all bytes in their order, as of the server that had the scenes of such clients within itself.
    let recordings = [ZOO, BALLS, AVATAR, REGION, REGION_BALLS];
    let digests = recordings.map(|packed| play(packed).1.digest);
    let expected = [
        0x3336_8c03_9f1b_0fd6,
        0xfb43_e2d1_4dbe_2fcd,
        0xe276_b474_2acd_313a,
        0xf99f_9462_1225_3957,
        0xc3b6_7687_8dbe_d59e,
    ];
    assert_eq!(digests, expected, "{digests:x?}");
}
