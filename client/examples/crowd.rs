//! Walks an avatar, under the client's authority, through a crowd.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this example.
//! The scene is seen from above: the avatar is `@`, a person who stands is `.`, and one who was pushed is `*`.

use std::io::Write;

use rhumb_client::glam::Vec3;
use rhumb_client::scene::{BodyDesc, LockedAxes, Material, SceneConfig, Shape};
use rhumb_client::{
    BodyId, BodyState, Client, InvalidMotion, JoinMode, JoinOptions, MainError, PipelineDepth,
    Tolerance, Trust,
};

/// Rows and columns of the crowd.
const CROWD: u8 = 12;
/// Distance between two persons, metres.
const SPACING: f32 = 0.9;
/// Speed of the avatar, m/s, along x.
const SPEED: f32 = 1.5;
/// Start of the walk, metres.
const START: f32 = -8.0;
const TICKS: u32 = 640;
/// Half of the straight part of a person's capsule, and its radius, metres.
const BODY: (f32, f32) = (0.6, 0.3);
/// Height of a person's centre, metres.
const HEIGHT: f32 = 0.9;
/// A person further than this from the first place was pushed, metres.
const PUSHED: f32 = 0.1;

/// State of the avatar at a tick.
fn walk(tick: u32) -> Result<BodyState, InvalidMotion> {
    let x = START + SPEED * tick as f32 / 60.0;
    BodyState::new(
        [x, HEIGHT, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [SPEED, 0.0, 0.0],
        [0.0; 3],
    )
}

/// The persons of the crowd, and where each of them stood first.
type Crowd = Vec<(BodyId, Vec3)>;

/// Adds a floor, the crowd, and the avatar.
fn furnish(client: &mut Client) -> Result<(Crowd, BodyId), MainError> {
    client.add_body(BodyDesc::fixed(Shape::cuboid(20.0, 0.5, 20.0)).at(0.0, -0.5, 0.0))?;
    let place = |i: u8| SPACING * (f32::from(i) - f32::from(CROWD - 1) / 2.0);
    let places = (0..CROWD)
        .flat_map(|row| (0..CROWD).map(move |column| Vec3::new(place(column), HEIGHT, place(row))));
    let places: Vec<Vec3> = places.collect();
    let person = |at: &Vec3| {
        let standing = BodyDesc::dynamic(Shape::capsule(BODY.0, BODY.1)).position(*at);
        standing.locked_axes(LockedAxes::ROTATIONS)
    };
    let persons = client.add_bodies(places.iter().map(person))?;
    let avatar = BodyDesc::kinematic(Shape::capsule(BODY.0, BODY.1));
    let avatar = client.add_body(avatar.at(START, HEIGHT, 0.0))?;
    Ok((persons.into_iter().zip(places).collect(), avatar))
}

/// Persons that are not where they stood.
fn pushed(client: &Client, crowd: &Crowd) -> usize {
    let moved = |(id, first): &&(BodyId, Vec3)| {
        let at = client.view().position(*id);
        at.is_some_and(|at| at.distance(*first) > PUSHED)
    };
    crowd.iter().filter(moved).count()
}

/// The scene from above, as lines of text: a character is 0.3 m wide and 0.6 m deep.
fn picture(client: &Client, crowd: &Crowd, avatar: Vec3) -> String {
    const COLUMNS: usize = 54;
    const ROWS: usize = 20;
    let mut lines = vec![vec![' '; COLUMNS]; ROWS];
    let mut put = |at: Vec3, letter: char| {
        let column = (at.x / 0.3).round() as i32 + COLUMNS as i32 / 2;
        let row = (at.z / 0.6).round() as i32 + ROWS as i32 / 2;
        let row = usize::try_from(row).ok().and_then(|row| lines.get_mut(row));
        let column = usize::try_from(column).unwrap_or(COLUMNS);
        if let Some(cell) = row.and_then(|row| row.get_mut(column)) {
            *cell = letter;
        }
    };
    for (id, first) in crowd {
        if let Some(at) = client.view().position(*id) {
            let moved = at.distance(*first) > PUSHED;
            put(at, if moved { '*' } else { '.' });
        }
    }
    put(avatar, '@');
    let lines = lines.into_iter().map(String::from_iter);
    lines.fold(String::new(), |text, line| text + line.trim_end() + "\n")
}

fn options() -> JoinOptions {
    let config = SceneConfig {
        // Persons of 70 kg, who do not slide far.
        material: Material {
            friction: 0.8,
            restitution: 0.0,
            density: 150.0,
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
    let mut client = Client::connect(&address, trust)?.join_with("crowd", options())?;
    let (crowd, avatar) = furnish(&mut client)?;
    client.take_authority(&[avatar], Tolerance::FINE)?;

    let mut out = std::io::stdout();
    for tick in 1..=TICKS {
        let state = walk(tick)?;
        client.publish(&[(avatar, state)])?;
        client.advance(PipelineDepth::LOCKSTEP)?;
        if tick % 160 == 0 {
            let at = client.view().position(avatar).ok_or("the avatar is gone")?;
            writeln!(out, "{}tick {tick}", picture(&client, &crowd, at))?;
        }
    }
    let sent = client.statistics().upstream;
    writeln!(
        out,
        "{} of {} persons were pushed aside; the walk took {} updates, {} bytes",
        pushed(&client, &crowd),
        crowd.len(),
        sent.updates,
        sent.bytes
    )?;
    Ok(client.delete()?)
}
