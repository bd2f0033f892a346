//! Balls fall into a pit, in a window of Bevy; the physics runs in a server.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this program.
//! The space bar kicks the balls upwards. `--picture FILE.png` saves what the window shows after three seconds, and ends.

use std::error::Error;
use std::f32::consts::{PI, TAU};
use std::path::PathBuf;

use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::math::{Quat, Vec3};
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::view::screenshot::{Captured, Screenshot, save_to_disk};
use rhumb_bevy::{RhumbBodyId, RhumbClient, RhumbEnded, RhumbJoin, RhumbJoinFailed, RhumbPlugin};
use rhumb_client::scene::{BodyBuilder, BodyDesc, Material, SceneConfig, Shape, Stepping};
use rhumb_client::{Client, Fingerprint, JoinMode, JoinOptions, Trust};

/// Simulated seconds after which a picture is taken: the balls are on their way down.
const PICTURE_SECONDS: f64 = 3.0;
/// Speed that the space bar gives to a ball, m/s.
const KICK: f32 = 8.0;

/// The server, from the command line.
#[derive(Resource)]
struct ServerArguments {
    address: String,
    fingerprint: Fingerprint,
}

/// The file of a picture, until it is requested.
#[derive(Resource)]
struct Picture(Option<PathBuf>);

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments
        .next()
        .ok_or("the server's host:port is missing")?;
    let fingerprint = arguments
        .next()
        .ok_or("its fingerprint is missing")?
        .parse()?;
    let picture = match arguments.next().as_deref() {
        None => None,
        Some("--picture") => Some(arguments.next().ok_or("--picture needs a file")?.into()),
        Some(other) => {
            return Err(format!("{other} is not known: only --picture FILE.png may follow").into());
        }
    };
    let window = Window {
        title: "Rhumb: a pit".to_owned(),
        resolution: (960, 600).into(),
        ..default()
    };
    let exit = App::new()
        .add_plugins(
            DefaultPlugins
                .set(WindowPlugin {
                    primary_window: Some(window),
                    ..default()
                })
                // A picture shows what there is: nothing is left out until its shaders are compiled.
                .set(RenderPlugin {
                    synchronous_pipeline_compilation: true,
                    ..default()
                }),
        )
        .add_plugins(RhumbPlugin::default())
        .insert_resource(ServerArguments {
            address,
            fingerprint,
        })
        .insert_resource(Picture(picture))
        .add_systems(Startup, (join, look_into_the_pit))
        .add_systems(
            Update,
            (
                draw_new_bodies,
                kick,
                take_picture,
                end_with_the_picture,
                say_why,
            ),
        )
        .run();
    match exit {
        AppExit::Success => Ok(()),
        AppExit::Error(code) => Err(format!("the app ended with code {code}").into()),
    }
}

/// Joins the scene beside the first frames, and furnishes it if it is empty.
fn join(server: Res<ServerArguments>, mut commands: Commands) -> Result {
    let (address, fingerprint) = (server.address.clone(), server.fingerprint);
    let join = RhumbJoin::start(move || {
        let options = JoinOptions {
            mode: JoinMode::CreateOrJoin(config()),
            ..JoinOptions::default()
        };
        let mut client = Client::connect(&address, Trust::Fingerprint(fingerprint))?
            .join_with("pit", options)?;
        if client.view().ids().is_empty() {
            client.add_bodies(bodies())?;
        }
        Ok(client)
    });
    commands.insert_resource(join?);
    Ok(())
}

/// Sends a command for each ball when the space bar is pressed.
fn kick(
    keys: Res<ButtonInput<KeyCode>>,
    client: Option<ResMut<RhumbClient>>,
    bodies: Query<&RhumbBodyId>,
) -> Result {
    let Some(mut client) = client.filter(|_| keys.just_pressed(KeyCode::Space)) else {
        return Ok(());
    };
    for body in &bodies {
        let mass = client.shape(body.id()).and_then(ball_mass);
        if let Some(mass) = mass {
            client.apply_impulse(body.id(), Vec3::Y * KICK * mass)?;
        }
    }
    Ok(())
}

fn take_picture(
    mut picture: ResMut<Picture>,
    client: Option<ResMut<RhumbClient>>,
    mut commands: Commands,
) {
    let Some(mut client) = client.filter(|_| picture.0.is_some()) else {
        return;
    };
    let step = client.inner().config().integrator.rate.step().seconds();
    let shown = client
        .inner()
        .view()
        .time()
        .map_or(0.0, |time| time.ticks() * step);
    if shown >= PICTURE_SECONDS
        && let Some(path) = picture.0.take()
    {
        commands
            .spawn(Screenshot::primary_window())
            .observe(save_to_disk(path));
    }
}

fn end_with_the_picture(captured: Query<(), Added<Captured>>, mut exit: MessageWriter<AppExit>) {
    if !captured.is_empty() {
        exit.write(AppExit::Success);
    }
}

/// Says on the log why there is no scene, or no scene any more.
fn say_why(mut failures: MessageReader<RhumbJoinFailed>, mut endings: MessageReader<RhumbEnded>) {
    for failure in failures.read() {
        error!("the scene cannot be joined: {}", failure.error);
    }
    for ending in endings.read() {
        error!("the scene has ended: {}", ending.error);
    }
}

/// Radius of the ring, metres.
const RING: f32 = 6.0;
/// Walls of the ring.
const WALLS: u8 = 24;
/// Half the height and half the thickness of a wall, metres.
const WALL: (f32, f32) = (1.0, 0.15);
/// Balls along each edge of the falling block, and layers of it.
const BALLS: (u8, u8) = (8, 6);
const RADIUS: f32 = 0.4;
/// Mass of a cubic metre, kg.
const DENSITY: f32 = 1_000.0;

/// Runs by the server's clock; balls bounce a little.
fn config() -> SceneConfig {
    SceneConfig {
        stepping: Stepping::FreeRunning,
        material: Material {
            friction: 0.4,
            restitution: 0.4,
            density: DENSITY,
        },
        ..SceneConfig::default()
    }
}

/// All bodies of the scene.
fn bodies() -> Vec<BodyBuilder> {
    let mut bodies = vec![BodyDesc::fixed(Shape::cuboid(12.0, 0.5, 12.0)).at(0.0, -0.5, 0.0)];
    let half_length = (RING + 2.0 * WALL.1) * (PI / f32::from(WALLS)).tan();
    let wall = Shape::cuboid(half_length, WALL.0, WALL.1);
    bodies.extend((0..WALLS).map(|i| {
        let turn = Quat::from_rotation_y(TAU * f32::from(i) / f32::from(WALLS));
        let at = turn * Vec3::new(0.0, WALL.0, RING + WALL.1);
        let body = BodyDesc::fixed(wall.clone()).at(at.x, at.y, at.z);
        body.rotation(rhumb_client::glam::Quat::from_array(turn.to_array()))
    }));
    let (edge, layers) = BALLS;
    let from_middle = |i: u8| 2.2 * RADIUS * (f32::from(i) - 0.5 * f32::from(edge - 1));
    for layer in 0..layers {
        for (row, column) in (0..edge).flat_map(|row| (0..edge).map(move |column| (row, column))) {
            // Each layer is a little aside of the one below, so that balls roll off each other.
            let aside = 0.1 * f32::from(layer % 3);
            let height = 5.0 + 2.2 * RADIUS * f32::from(layer);
            let at = [
                from_middle(row) + aside,
                height,
                from_middle(column) - aside,
            ];
            bodies.push(BodyDesc::dynamic(Shape::ball(RADIUS)).position(at));
        }
    }
    bodies
}

/// The mass of a ball, kg; `None` for another shape.
fn ball_mass(shape: &Shape) -> Option<f32> {
    match shape {
        Shape::Ball { radius } => Some(DENSITY * 4.0 / 3.0 * PI * radius.powi(3)),
        _ => None,
    }
}

/// Hues of the balls, degrees.
const HUES: [f32; 6] = [5.0, 35.0, 50.0, 150.0, 205.0, 270.0];

/// Gives new bodies a mesh by their shapes.
fn draw_new_bodies(
    client: Option<ResMut<RhumbClient>>,
    added: Query<(Entity, &RhumbBodyId), Added<RhumbBodyId>>,
    mut commands: Commands,
    mut meshes: ResMut<Assets<Mesh>>,
    mut materials: ResMut<Assets<StandardMaterial>>,
) {
    let Some(mut client) = client else {
        return;
    };
    for (entity, body) in &added {
        let Some((mesh, color)) = client.shape(body.id()).and_then(|shape| drawn(shape, body))
        else {
            warn!(
                "{:?} has a shape that this example does not draw",
                body.id()
            );
            continue;
        };
        commands.entity(entity).insert((
            Mesh3d(meshes.add(mesh)),
            MeshMaterial3d(materials.add(StandardMaterial {
                base_color: color,
                perceptual_roughness: 0.6,
                ..default()
            })),
        ));
    }
}

fn drawn(shape: &Shape, body: &RhumbBodyId) -> Option<(Mesh, Color)> {
    let hue = HUES[body.id().index() as usize % HUES.len()];
    match shape {
        Shape::Ball { radius } => Some((
            Sphere::new(*radius).mesh().uv(24, 16),
            Color::hsl(hue, 0.75, 0.5),
        )),
        Shape::Cuboid { half_extents } => {
            let edges = 2.0 * Vec3::from_array(half_extents.to_array());
            Some((
                Cuboid::from_size(edges).into(),
                Color::srgb(0.55, 0.58, 0.62),
            ))
        }
        _ => None,
    }
}

/// Places the camera and the light.
fn look_into_the_pit(mut commands: Commands) {
    commands.spawn((
        Camera3d::default(),
        Tonemapping::None,
        Transform::from_xyz(0.0, 11.0, 15.0).looking_at(Vec3::new(0.0, 1.5, 0.0), Vec3::Y),
    ));
    commands.spawn((
        DirectionalLight {
            illuminance: 9_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(6.0, 14.0, 8.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}
