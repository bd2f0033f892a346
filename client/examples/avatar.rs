//! Walks an avatar, under the client's authority, through a scene of boxes.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this example.

use std::f32::consts::TAU;
use std::io::Write;
use std::time::Duration;

use rhumb_client::glam::{Quat, Vec3};
use rhumb_client::scene::{BodyDesc, Material, SceneConfig, Shape, Stepping};
use rhumb_client::{BodyId, BodyState, Client, JoinMode, JoinOptions, MainError, Tolerance, Trust};

/// Duration of a frame of this program, independent of the server's tick.
const FRAME: Duration = Duration::from_millis(11);
/// Radius of the avatar's circle, metres.
const RADIUS: f32 = 2.0;
/// Duration of one round, seconds.
const ROUND_SECONDS: f32 = 10.0;

/// State of the avatar `seconds` after its start.
fn walk(seconds: f32) -> BodyState {
    let (sin, cos) = (seconds * TAU / ROUND_SECONDS).sin_cos();
    let speed = RADIUS * TAU / ROUND_SECONDS;
    let turn = Quat::from_rotation_y(-seconds * TAU / ROUND_SECONDS);
    BodyState::new(
        [RADIUS * cos, 0.9, RADIUS * sin],
        turn.to_array(),
        [-speed * sin, 0.0, speed * cos],
        [0.0, -TAU / ROUND_SECONDS, 0.0],
    )
    .expect("a walk is finite")
}

/// Adds a floor, three boxes in the avatar's path, and the avatar; returns its id.
fn furnish(client: &mut Client) -> Result<BodyId, MainError> {
    let floor = BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0);
    let boxes = [(0.0, RADIUS), (-RADIUS, 0.0), (0.0, -RADIUS)]
        .map(|(x, z)| BodyDesc::dynamic(Shape::cuboid(0.2, 0.2, 0.2)).at(x, 0.2, z));
    client.add_bodies([floor].into_iter().chain(boxes))?;
    let person = BodyDesc::kinematic(Shape::capsule(0.6, 0.3));
    Ok(client.add_body(person.at(RADIUS, 0.9, 0.0))?)
}

fn options() -> JoinOptions {
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 100.0,
        },
        ..SceneConfig::default()
    };
    JoinOptions {
        mode: JoinMode::Create(config),
        ..JoinOptions::default()
    }
}

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments
        .next()
        .ok_or("the server's host:port is missing")?;
    let fingerprint = arguments.next().ok_or("its fingerprint is missing")?;
    let trust = Trust::Fingerprint(fingerprint.parse()?);
    let mut client = Client::connect(&address, trust)?.join_with("avatar", options())?;
    let avatar = furnish(&mut client)?;
    client.take_authority(&[avatar], Tolerance::FINE)?;

    let mut out = std::io::stdout();
    let frames = (ROUND_SECONDS / FRAME.as_secs_f32()) as u32;
    for frame in 0..frames {
        let seconds = frame as f32 * FRAME.as_secs_f32();
        client.publish(&[(avatar, walk(seconds))])?;
        client.poll()?;
        let view = client.view();
        for place in view.changed().filter(|place| view.ids()[*place] != avatar) {
            let (id, at): (BodyId, Vec3) = (view.ids()[place], view.positions()[place]);
            writeln!(out, "{id} is pushed to {at}")?;
        }
        client.idle(FRAME)?;
    }
    let sent = client.statistics().upstream;
    writeln!(
        out,
        "the client published the walk in {} updates, {} bytes",
        sent.updates, sent.bytes
    )?;
    Ok(client.delete()?)
}
