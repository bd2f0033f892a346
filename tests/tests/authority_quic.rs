//! A client drives bodies of a server process over QUIC on loopback.
//!
//! Waiting is always a client's call with its patience; no time is asserted. What the server has is read by another client
//! that follows every state of every tick.

use std::time::Duration;

use rhumb_client::PipelineDepth;
use rhumb_client::scene::{Command, CommandError, SceneConfig, Stepping};
use rhumb_client::{
    AuthorityError, BodyId, BodyState, Client, ClientError, Event, JoinMode, JoinOptions,
    StreamChoice, Tick, Tolerance, Trust,
};
use rhumb_protocol::session::Misuse;
use rhumb_sims::Script;
use rhumb_tests::{Avatars, Programme, ServerProcess};

const SERVER: Programme = Programme(env!("CARGO_BIN_EXE_rhumb-test-server"));
/// Two hundredths of a metre.
const CLOSE: Tolerance = Tolerance::FINE;
/// The same with what f32 rounds.
const CLOSE_METRES: f32 = 0.020_01;

fn join(server: &ServerProcess, options: JoinOptions) -> Client {
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust).expect("it is there");
    connection
        .join_with("driven", options)
        .expect("it is there")
}

/// A scene with one avatar, the client that made it and may drive it, and one that sees every state.
fn open(server: &ServerProcess, stepping: Stepping) -> (Client, Client) {
    let mut script = Avatars(1);
    let config = SceneConfig {
        stepping,
        ..script.config()
    };
    let create = JoinOptions {
        mode: JoinMode::Create(config),
        ..JoinOptions::default()
    };
    let mut driver = join(server, create);
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in commands {
        driver.command(command).expect("the connection stands");
    }
    let full = JoinOptions {
        mode: JoinMode::Join,
        stream: StreamChoice::Full,
        ..JoinOptions::default()
    };
    (driver, join(server, full))
}

/// Waits for the answer to a wish to drive.
fn answer(client: &mut Client) -> Result<Vec<BodyId>, AuthorityError> {
    loop {
        client
            .idle(Duration::from_millis(2))
            .expect("the connection stands");
        while let Some((_, event)) = client.poll_event() {
            match event {
                Event::AuthorityGrant(bodies) => return Ok(bodies),
                Event::AuthorityDenied(error) => return Err(error),
                _ => {}
            }
        }
    }
}

/// How far the body that a client sees is from a place, metres.
fn off(client: &Client, id: BodyId, motion: &BodyState) -> f32 {
    let view = client.view();
    let place = view.place(id).expect("the body is there");
    let at = glam::Vec3::from_array(motion.position());
    view.positions()[place].distance(at)
}

#[test]
fn in_lockstep_the_server_has_an_avatar_where_its_simulator_does() {
    walks_in_lockstep(PipelineDepth::LOCKSTEP, 0);
    walks_in_lockstep(PipelineDepth::PIPELINED, 1);
}

fn walks_in_lockstep(depth: PipelineDepth, behind: u64) {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut driver, mut watcher) = open(&server, Stepping::Lockstep);
    let id = Avatars::id(0);
    driver.take_authority(&[id], CLOSE).expect("it may ask");
    assert_eq!(answer(&mut driver), Ok(vec![id]));
    let mut last = Avatars::walk(0, Tick::ZERO);
    for tick in (1..=300).map(Tick::new) {
        let walk = Avatars::walk(0, tick);
        let sent = driver.publish(&[(id, walk)]).expect("it drives");
        assert_eq!(sent, Some(tick));
        let shown = driver.advance(depth).expect("the server steps");
        assert!(shown.value() + behind >= tick.value(), "{shown} at {tick}");
        last = walk;
        while watcher.statistics().complete < tick {
            watcher
                .idle(Duration::from_millis(1))
                .expect("the connection stands");
        }
        watcher
            .wait(PipelineDepth::LOCKSTEP)
            .expect("it is complete");
        let error = off(&watcher, id, &walk);
        assert!(error <= CLOSE_METRES, "off by {error} m at {tick}");
    }
    // The driver's own copy is within both tolerances, and as far behind as it waits.
    let way = 1.4 / 60.0 * behind as f32;
    assert!(off(&driver, id, &last) <= CLOSE_METRES + 0.05 + way);
    let sent = driver.statistics().driven;
    assert!(sent.updates < 100, "{sent:?}");
}

#[test]
fn a_free_running_server_has_an_avatar_where_it_came_to_stand() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut driver, mut watcher) = open(&server, Stepping::FreeRunning);
    let id = Avatars::id(0);
    driver.take_authority(&[id], CLOSE).expect("it may ask");
    // Each frame of this client is one of the walk, however long it took.
    let mut place = Avatars::walk(0, Tick::ZERO);
    for frame in 0..150 {
        place = Avatars::walk(0, Tick::new(frame));
        driver.publish(&[(id, place)]).expect("it asked to drive");
        driver
            .idle(Duration::from_millis(5))
            .expect("the connection stands");
    }
    let place = place.stilled();
    let way = driver.statistics().wire.round_trip.as_secs_f64() / 2.0;
    driver.set_lead_ticks(way * 60.0 + 1.0);
    while watcher.view().place(id).is_none() || off(&watcher, id, &place) > CLOSE_METRES {
        driver.publish(&[(id, place)]).expect("it drives");
        driver
            .idle(Duration::from_millis(5))
            .expect("the connection stands");
        watcher
            .idle(Duration::from_millis(5))
            .expect("the connection stands");
        watcher.poll().expect("the connection stands");
    }
    assert_eq!(driver.authority_bodies().collect::<Vec<_>>(), [id]);
}

#[test]
fn a_refused_authority_request_states_its_reason() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut driver, mut other) = open(&server, Stepping::FreeRunning);
    let id = Avatars::id(0);
    let stands = Avatars::walk(0, Tick::ZERO).stilled();
    let error = driver
        .publish(&[(id, stands)])
        .expect_err("it drives nothing");
    assert!(
        matches!(error, ClientError::Misuse(Misuse::NoAuthority(_))),
        "{error}"
    );
    assert!(error.to_string().contains("body 4.0"), "{error}");
    driver
        .take_authority(&[Avatars::freight()], CLOSE)
        .expect("it may ask");
    let refused = answer(&mut driver).expect_err("it is not kinematic");
    assert_eq!(refused, AuthorityError::NotKinematic(Avatars::freight()));
    assert!(refused.to_string().contains("not kinematic"), "{refused}");
    other.take_authority(&[id], CLOSE).expect("it may ask");
    assert_eq!(answer(&mut other), Err(AuthorityError::NotYours(id)));
    driver.take_authority(&[id], CLOSE).expect("it may ask");
    // Who has asked may say where it is, though nobody hears it yet.
    driver.publish(&[(id, stands)]).expect("it asked to drive");
    assert_eq!(answer(&mut driver), Ok(vec![id]));
    let command = Command::SetPose {
        id,
        position: glam::Vec3::Y,
        rotation: glam::Quat::IDENTITY,
    };
    other.command(command).expect("it may ask");
    let refused = loop {
        other
            .idle(Duration::from_millis(2))
            .expect("the connection stands");
        if let Some((_, Event::Refused { error, .. })) = other.poll_event() {
            break error;
        }
    };
    assert_eq!(refused, CommandError::UnderAuthority(id));
    let far = BodyState::new([1e6, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    let error = driver
        .publish(&[(id, far.expect("it is finite"))])
        .expect_err("no such place");
    assert!(error.to_string().contains("position"), "{error}");
}
