//! Creates a scene, drops a ball on a floor, and follows it until it rests.
//!
//! Start `rhumb-server` first; it prints the fingerprint that this takes as its argument.

use std::num::NonZeroU32;
use std::process::ExitCode;

use rhumb_client::glam::Vec3;
use rhumb_client::scene::{
    BodyDesc, BodyKind, Command, Material, PublishSchedule, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_client::{
    BodyId, BodyState, Client, Damping, Integrator, JoinMode, Options, PipelineDepth, Rate, Trust,
};

const FLOOR: ShapeId = ShapeId(0);
const BALL: ShapeId = ShapeId(1);

fn config() -> SceneConfig {
    SceneConfig {
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        gravity: Vec3::new(0.0, -9.806_65, 0.0),
        stepping: Stepping::Lockstep,
        material: Material {
            friction: 0.5,
            restitution: 0.0,
            density: 1_000.0,
        },
        damping: Damping {
            linear: 0.0,
            angular: 0.05,
        },
        sleep: None,
        publish_schedule: PublishSchedule::EACH_TICK,
    }
}

fn add(
    client: &mut Client,
    id: BodyId,
    kind: BodyKind,
    shape: ShapeId,
    height: f32,
) -> Result<(), Box<dyn std::error::Error>> {
    let motion = BodyState::new([0.0, height, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])?;
    let desc = BodyDesc::plain(id, kind, shape);
    client.command(Command::AddBody { desc, motion })?;
    Ok(())
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
        "drop".parse()?,
        join_mode,
    ))?;

    let half_extents = Vec3::new(10.0, 0.5, 10.0);
    let shape = Shape::Cuboid { half_extents };
    client.command(Command::AddShape { id: FLOOR, shape })?;
    let shape = Shape::Ball { radius: 0.5 };
    client.command(Command::AddShape { id: BALL, shape })?;
    let granted = client.granted();
    let (floor, ball) = granted
        .id(0)
        .zip(granted.id(1))
        .ok_or("the server granted no indices")?;
    add(&mut client, floor, BodyKind::Static, FLOOR, -0.5)?;
    add(&mut client, ball, BodyKind::Dynamic, BALL, 5.0)?;

    let mut report = String::new();
    for _ in 0..300 {
        let tick = client.advance(PipelineDepth::LOCKSTEP)?;
        let view = client.view();
        if tick.value().is_multiple_of(30)
            && let Some(place) = view.place(ball)
        {
            let (at, bound) = (view.positions()[place], client.bound(ball));
            report += &format!(
                "{tick}: {at}, {bound:?}, resting {}\n",
                view.resting()[place]
            );
        }
    }
    std::io::Write::write_all(&mut std::io::stdout(), report.as_bytes())?;
    client.delete()?;
    Ok(())
}
