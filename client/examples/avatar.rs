//! Walks an avatar through a scene of boxes: what this program moves itself.
//!
//! Start `rhumb-server` first; it prints the fingerprint that this takes as its argument.

use std::f32::consts::TAU;
use std::num::NonZeroU32;
use std::process::ExitCode;
use std::time::Duration;

use rhumb_client::glam::{Quat, Vec3};
use rhumb_client::scene::{
    BodyDesc, BodyKind, Command, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_client::{
    BodyId, BodyState, Client, ClientEvent, Damping, Integrator, JoinMode, Options, Rate,
    Tolerance, Trust,
};

const FLOOR: ShapeId = ShapeId(0);
const PERSON: ShapeId = ShapeId(1);
const BOX: ShapeId = ShapeId(2);
/// One frame of this program, whatever the server's tick is.
const FRAME: Duration = Duration::from_millis(11);
/// The avatar walks in a circle of so many metres, once in so many seconds.
const RADIUS: f32 = 2.0;
const ROUND_SECONDS: f32 = 10.0;

fn config() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        gravity: Vec3::new(0.0, -9.806_65, 0.0),
        stepping: Stepping::FreeRunning,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 100.0,
        },
        damping: Damping {
            linear: 0.0,
            angular: 0.05,
        },
        sleep: None,
        publish_schedule: PublishSchedule::EACH_TICK,
    }
}

/// Where the avatar is so many seconds after it set out, and how it moves.
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

fn furnish(client: &mut Client) -> Result<BodyId, Box<dyn std::error::Error>> {
    let slab = |x, y, z| Shape::Cuboid {
        half_extents: Vec3::new(x, y, z),
    };
    let person = Shape::Capsule {
        half_height: 0.6,
        radius: 0.3,
    };
    for (id, shape) in [
        (FLOOR, slab(10.0, 0.5, 10.0)),
        (PERSON, person),
        (BOX, slab(0.2, 0.2, 0.2)),
    ] {
        client.command(Command::AddShape { id, shape })?;
    }
    let granted = client.granted();
    let mut places = (0..granted.count()).filter_map(|place| granted.id(place));
    let mut add = |client: &mut Client, kind, shape, motion| {
        let id = places.next().ok_or("the server granted too few indices")?;
        let desc = BodyDesc::plain(id, kind, shape);
        client.command(Command::AddBody { desc, motion })?;
        Ok::<BodyId, Box<dyn std::error::Error>>(id)
    };
    let at = |x, y, z| BodyState::new([x, y, z], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    add(client, BodyKind::Static, FLOOR, at(0.0, -0.5, 0.0)?)?;
    for (x, z) in [(0.0, RADIUS), (-RADIUS, 0.0), (0.0, -RADIUS)] {
        add(client, BodyKind::Dynamic, BOX, at(x, 0.2, z)?)?;
    }
    add(client, BodyKind::Kinematic, PERSON, walk(0.0))
}

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn std::error::Error>> {
    let fingerprint = std::env::args()
        .nth(1)
        .ok_or("the server's fingerprint is missing")?;
    let trust = Trust::Fingerprint(fingerprint.parse()?);
    let join_mode = JoinMode::Create(config());
    let mut client = Client::open(Options::new(
        "127.0.0.1:4433",
        trust,
        "avatar".parse()?,
        join_mode,
    ))?;
    let avatar = furnish(&mut client)?;
    client.take_authority(&[avatar], Tolerance::FINE)?;

    let mut report = String::new();
    let frames = (ROUND_SECONDS / FRAME.as_secs_f32()) as u32;
    for frame in 0..frames {
        let seconds = frame as f32 * FRAME.as_secs_f32();
        client.publish(&[(avatar, walk(seconds))])?;
        client.poll()?;
        let view = client.view();
        for place in view.changed().filter(|place| view.ids()[*place] != avatar) {
            let (id, at) = (view.ids()[place], view.positions()[place]);
            report += &format!("{id} is pushed to {at}\n");
        }
        while let Some(client_event) = client.poll_event() {
            if let ClientEvent::AuthorityDenied(error) = client_event {
                return Err(error.into());
            }
        }
        client.idle(FRAME)?;
    }
    let said = client.statistics().driven;
    report += &format!(
        "{} updates in {} bytes said where it went\n",
        said.updates, said.bytes
    );
    std::io::Write::write_all(&mut std::io::stdout(), report.as_bytes())?;
    client.delete()?;
    Ok(())
}
