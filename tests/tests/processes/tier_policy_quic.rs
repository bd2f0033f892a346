//! The server changes the tier of a client behind a slow link, over QUIC.
//!
//! The tests use a server process, the public client and a relay of limited rate. Waiting is a client's call with its
//! time limit; durations are not asserted.

use std::time::Duration;

use glam::Vec3;
use rhumb_client::scene::{BodyDesc, Command, SceneConfig, Shape, Stepping};
use rhumb_client::{
    BodyId, Client, Event, JoinMode, JoinOptions, StreamChoice, TierChangeCause, Tolerance, Trust,
};
use rhumb_netsim::{LinkConfig, UdpRelay};
use rhumb_sims::{BallPit, Script};
use rhumb_tests::ServerProcess;

use crate::SERVER;

const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const BALLS: u32 = 40;

fn open(address: &str, server: &ServerProcess, stream: StreamChoice) -> Client {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        gravity: Vec3::ZERO,
        ..BallPit::new(1, 1, 1).config()
    };
    let options = JoinOptions {
        mode: JoinMode::CreateOrJoin(config),
        stream,
        ..JoinOptions::default()
    };
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect_within(address, trust, Duration::from_secs(30));
    let joined = connection.and_then(|connection| connection.join_with("thin", options));
    joined.expect("the server is there")
}

/// Balls far from each other.
fn place(client: &mut Client) -> Vec<BodyId> {
    let ball = |index| BodyDesc::dynamic(Shape::ball(0.5)).at(index as f32 * 50.0, 0.0, 0.0);
    let added = client.add_bodies((0..BALLS).map(ball));
    added.expect("they are bodies")
}

/// Another velocity for each ball: fine tiers must publish all of them.
fn shake(client: &mut Client, balls: &[BodyId], turn: u32) {
    for (index, id) in (0..).zip(balls) {
        let roll = |part: u32| {
            let mixed = (turn * 31 + index * 17 + part * 7).wrapping_mul(2_654_435_761);
            (mixed >> 8) as f32 / (1 << 23) as f32 - 1.0
        };
        let task = Command::SetVelocity {
            id: *id,
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
    let balls = place(&mut commander);
    let wide: LinkConfig = "rtt=20ms".parse().expect("these are config of a link");
    let anywhere = "127.0.0.1:0".parse().expect("an address of loopback");
    let relay = UdpRelay::start(anywhere, server.address, wide, 1).expect("starting the relay");
    let mut member = open(&relay.local_addr().to_string(), &server, EXACT);
    assert_eq!(member.stream(), Some(EXACT));
    let thin = "rtt=20ms,rate=24kbit,queue=64kB";
    relay.set_config(thin.parse().expect("a valid link configuration"));
    let (mut moved, mut followed) = (None, None);
    for turn in 0..2_400 {
        shake(&mut commander, &balls, turn);
        commander
            .idle(Duration::from_millis(8))
            .expect("the server is running");
        member
            .idle(Duration::from_millis(8))
            .expect("the server is there");
        while let Some((_, event)) = member.poll_event() {
            match event {
                Event::TierChanged { to, cause } => moved = moved.or(Some((to, cause))),
                Event::SubscriptionChanged(choice) => followed = Some(choice),
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
