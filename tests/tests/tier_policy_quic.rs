//! The server changes the tier of a client behind a slow link, over QUIC.
//!
//! The tests use a server process, the public client and a relay of limited rate. Waiting is a client's call with its
//! time limit; durations are not asserted.

use std::time::Duration;

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId, Stepping};
use rhumb_client::{
    BodyId, Client, ClientEvent, JoinMode, Options, StreamChoice, TierChangeCause, Tolerance, Trust,
};
use rhumb_reckoning::BodyState;
use rhumb_sims::{BallPit, Script};
use rhumb_tests::{Programme, ServerProcess};
use rhumb_transport::{LinkConfig, UdpRelay};

const SERVER: Programme = Programme(env!("CARGO_BIN_EXE_rhumb-test-server"));
const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const BALLS: u32 = 40;

fn open(address: &str, server: &ServerProcess, stream: StreamChoice) -> Client {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        gravity: Vec3::ZERO,
        ..BallPit::new(1, 1, 1).config()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let scene = "thin".parse().expect("a valid scene name");
    let mut options = Options::new(
        address.to_owned(),
        trust,
        scene,
        JoinMode::CreateOrJoin(config),
    );
    options.stream = stream;
    options.patience = Duration::from_secs(30);
    Client::open(options).expect("the server is running")
}

/// Adds balls far from each other.
fn place(client: &mut Client) {
    let shape = Shape::Ball { radius: 0.5 };
    let add = Command::AddShape {
        id: ShapeId(0),
        shape,
    };
    client.command(add).expect("a valid shape");
    for index in 0..BALLS {
        let at = [index as f32 * 50.0, 0.0, 0.0];
        let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let config = BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, ShapeId(0));
        let motion = motion.expect("a finite state");
        let add = Command::AddBody { config, motion };
        client.command(add).expect("a valid body");
    }
}

/// Changes the velocity of each ball, so that fine tiers need an update for each.
fn shake(client: &mut Client, turn: u32) {
    for index in 0..BALLS {
        let roll = |part: u32| {
            let mixed = (turn * 31 + index * 17 + part * 7).wrapping_mul(2_654_435_761);
            (mixed >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let task = Command::SetVelocity {
            id: BodyId::new(index, 0),
            linear: Vec3::new(roll(0), roll(1), roll(2)),
            angular: Vec3::ZERO,
        };
        client.command(task).expect("a valid velocity");
    }
}

#[test]
fn a_client_behind_a_thin_link_changes_to_a_coarser_tier_and_is_notified() {
    let server = SERVER.serve("127.0.0.1:0");
    let mut commander = open(
        &server.address.to_string(),
        &server,
        StreamChoice::Within(Tolerance::COARSE),
    );
    place(&mut commander);
    let wide: LinkConfig = "rtt=20ms".parse().expect("a valid link configuration");
    let anywhere = "127.0.0.1:0".parse().expect("an address of loopback");
    let relay = UdpRelay::start(anywhere, server.address, wide, 1).expect("starting the relay");
    let mut member = open(&relay.local_addr().to_string(), &server, EXACT);
    assert_eq!(member.stream(), Some(EXACT));
    let thin = "rtt=20ms,rate=24kbit,queue=64kB";
    relay.set_config(thin.parse().expect("a valid link configuration"));
    let (mut moved, mut followed) = (None, None);
    for turn in 0..2_400 {
        shake(&mut commander, turn);
        commander
            .idle(Duration::from_millis(8))
            .expect("the server is running");
        member
            .idle(Duration::from_millis(8))
            .expect("the server is running");
        while let Some(client_event) = member.poll_event() {
            match client_event {
                ClientEvent::TierChanged { to, cause } => moved = moved.or(Some((to, cause))),
                ClientEvent::SubscriptionChanged(choice) => followed = Some(choice),
                _ => {}
            }
        }
        while commander.poll_event().is_some() {}
        if followed.is_some() {
            break;
        }
    }
    let wire = member.statistics().wire;
    let (to, cause) = moved.unwrap_or_else(|| panic!("no change was notified: {wire:?}"));
    assert_eq!(
        (to, cause),
        (
            StreamChoice::Within(Tolerance::FINE),
            TierChangeCause::LinkCongested
        )
    );
    // The copy and its bounds belong to the stream that the server chose.
    let choice = followed.expect("it changed its stream");
    assert_ne!(choice, EXACT);
    assert_eq!(member.stream(), Some(choice));
    assert_eq!(member.tolerance(), Some(choice.tolerance()));
}
