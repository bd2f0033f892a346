//! A client publishes bodies to a server process over QUIC on loopback.
//!
//! Waiting is always a client's call with its time limit; no durations are asserted. Another client with a full stream
//! reads the server's states.

use std::time::Duration;

use rhumb_client::PipelineDepth;
use rhumb_client::scene::{Command, CommandError, SceneConfig, Stepping};
use rhumb_client::{
    AuthorityError, BodyId, BodyState, Client, ClientError, Event, JoinMode, JoinOptions,
    StreamChoice, Tick, Tolerance, Trust,
};
use rhumb_protocol::session::Misuse;
use rhumb_sims::Script;
use rhumb_tests::{Avatars, ServerProcess};

use crate::SERVER;

/// A tolerance of two centimetres.
const CLOSE: Tolerance = Tolerance::FINE;
/// The same in metres, plus rounding to f32.
const CLOSE_METRES: f32 = 0.020_01;

fn join(server: &ServerProcess, options: JoinOptions) -> Client {
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection =
        Client::connect(&server.address.to_string(), trust).expect("the server is running");
    connection
        .join_with("driven", options)
        .expect("the server is running")
}

/// A scene with one avatar, the client that creates it and may publish it, and one with a full stream.
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
    let mut publisher = join(server, create);
    let mut commands = Vec::new();
    script.commands(Tick::ZERO, &mut commands);
    for command in commands {
        publisher.command(command).expect("the connection is open");
    }
    let full = JoinOptions {
        mode: JoinMode::Join,
        stream: StreamChoice::Full,
        ..JoinOptions::default()
    };
    (publisher, join(server, full))
}

/// Waits for the answer to a request for authority.
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

/// Distance of the body in a client's view from a state, in metres.
fn off(client: &Client, id: BodyId, motion: &BodyState) -> f32 {
    let view = client.view();
    let place = view.place(id).expect("an existing body");
    let at = glam::Vec3::from_array(motion.position());
    view.positions()[place].distance(at)
}

#[test]
fn in_lockstep_the_server_follows_a_published_avatar() {
    walks_in_lockstep(PipelineDepth::LOCKSTEP, 0);
    walks_in_lockstep(PipelineDepth::PIPELINED, 1);
}

fn walks_in_lockstep(depth: PipelineDepth, behind: u64) {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut publisher, mut watcher) = open(&server, Stepping::Lockstep);
    let id = Avatars::id(0);
    publisher.take_authority(&[id], CLOSE).expect("a member");
    assert_eq!(answer(&mut publisher), Ok(vec![id]));
    let mut last = Avatars::walk(0, Tick::ZERO);
    for tick in (1..=300).map(Tick::new) {
        let walk = Avatars::walk(0, tick);
        let sent = publisher
            .publish(&[(id, walk)])
            .expect("a body under authority");
        assert_eq!(sent, Some(tick));
        let shown = publisher.advance(depth).expect("the server steps");
        assert!(shown.value() + behind >= tick.value(), "{shown} at {tick}");
        last = walk;
        while watcher.statistics().complete < tick {
            watcher
                .idle(Duration::from_millis(1))
                .expect("the connection is open");
        }
        watcher
            .wait(PipelineDepth::LOCKSTEP)
            .expect("a complete tick");
        let error = off(&watcher, id, &walk);
        assert!(error <= CLOSE_METRES, "the error at {tick} is {error} m");
    }
    // The publisher's own copy is within both tolerances, and as many ticks behind as the pipeline is deep.
    let path = 1.4 / 60.0 * behind as f32;
    assert!(off(&publisher, id, &last) <= CLOSE_METRES + 0.05 + path);
    let sent = publisher.statistics().upstream;
    assert!(sent.updates < 100, "{sent:?}");
}

#[test]
fn a_free_running_server_has_the_final_state_of_an_avatar() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut publisher, mut watcher) = open(&server, Stepping::FreeRunning);
    let id = Avatars::id(0);
    publisher.take_authority(&[id], CLOSE).expect("a member");
    // Each frame of this client is one tick of the trajectory, however long it takes.
    let mut place = Avatars::walk(0, Tick::ZERO);
    for frame in 0..150 {
        place = Avatars::walk(0, Tick::new(frame));
        publisher
            .publish(&[(id, place)])
            .expect("authority was requested");
        publisher
            .idle(Duration::from_millis(5))
            .expect("the connection is open");
    }
    let place = place.stilled();
    let path = publisher.statistics().wire.round_trip.as_secs_f64() / 2.0;
    let led = publisher.set_lead_ticks(path * 60.0 + 1.0);
    led.expect("a round trip is finite");
    while watcher.view().place(id).is_none() || off(&watcher, id, &place) > CLOSE_METRES {
        publisher
            .publish(&[(id, place)])
            .expect("a body under authority");
        publisher
            .idle(Duration::from_millis(5))
            .expect("the connection is open");
        watcher
            .idle(Duration::from_millis(5))
            .expect("the connection is open");
        watcher.poll().expect("the connection is open");
    }
    assert_eq!(publisher.authority_bodies().collect::<Vec<_>>(), [id]);
}

#[test]
fn a_refused_authority_request_states_its_reason() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut publisher, mut other) = open(&server, Stepping::FreeRunning);
    let id = Avatars::id(0);
    let stands = Avatars::walk(0, Tick::ZERO).stilled();
    let error = publisher
        .publish(&[(id, stands)])
        .expect_err("a client without authority");
    assert!(
        matches!(error, ClientError::Misuse(Misuse::NoAuthority(_))),
        "{error}"
    );
    assert!(error.to_string().contains("body 4.0"), "{error}");
    publisher
        .take_authority(&[Avatars::freight()], CLOSE)
        .expect("a member");
    let refused = answer(&mut publisher).expect_err("a body that is not kinematic");
    assert_eq!(refused, AuthorityError::NotKinematic(Avatars::freight()));
    assert!(refused.to_string().contains("not kinematic"), "{refused}");
    other.take_authority(&[id], CLOSE).expect("a member");
    assert_eq!(answer(&mut other), Err(AuthorityError::NotYours(id)));
    publisher.take_authority(&[id], CLOSE).expect("a member");
    // A client may publish while its request is pending; no one receives the states yet.
    publisher
        .publish(&[(id, stands)])
        .expect("authority was requested");
    assert_eq!(answer(&mut publisher), Ok(vec![id]));
    let command = Command::SetPose {
        id,
        position: glam::Vec3::Y,
        rotation: glam::Quat::IDENTITY,
    };
    other.command(command).expect("a member");
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
    let error = publisher
        .publish(&[(id, far.expect("a finite state"))])
        .expect_err("a place outside the limits");
    assert!(error.to_string().contains("position"), "{error}");
}
