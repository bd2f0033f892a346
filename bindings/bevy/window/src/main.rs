//! Balls fall into a pit, in a window of Bevy; the physics runs in a server.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this program.
//! The space bar kicks the balls upwards. `--picture FILE.png` saves what the window shows after three seconds, and ends.

mod drawing;
mod pit;

use std::error::Error;
use std::path::PathBuf;

use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::view::screenshot::{Captured, Screenshot, save_to_disk};
use rhumb_bevy::{RhumbBodyId, RhumbClient, RhumbEnded, RhumbJoin, RhumbJoinFailed, RhumbPlugin};
use rhumb_client::{Client, Fingerprint, JoinMode, JoinOptions, Trust};

use crate::drawing::{draw_new_bodies, look_into_the_pit};

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
            mode: JoinMode::CreateOrJoin(pit::config()),
            ..JoinOptions::default()
        };
        let mut client = Client::connect(&address, Trust::Fingerprint(fingerprint))?
            .join_with("pit", options)?;
        if client.view().ids().is_empty() {
            client.add_bodies(pit::bodies())?;
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
        let mass = client.shape(body.id()).and_then(pit::ball_mass);
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
