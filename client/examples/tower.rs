//! A ball knocks over a tower of boxes, drawn as text in the terminal.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this example.
//! In a terminal, each picture replaces the one before; otherwise they follow each other.

use std::io::{IsTerminal, Write};
use std::time::Duration;

use rhumb_client::glam::{Quat, Vec3};
use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{BodyId, Client, MainError, PipelineDepth, Trust};

const BOXES: u8 = 10;
/// Half of a box's edge, metres.
const HALF: f32 = 0.5;
/// Radius of the ball, metres.
const RADIUS: f32 = 0.75;
const TICKS: u32 = 300;
/// Ticks from one picture to the next.
const TICKS_SHOWN: u32 = 4;
/// Time for which a picture stays in a terminal: so many ticks of 60 a second.
const STAYS: Duration = Duration::from_millis(66);
/// Characters of a picture. A character is half a metre high and a quarter of a metre wide.
const COLUMNS: usize = 72;
const ROWS: usize = 23;

/// A body of the picture.
struct Drawn {
    id: BodyId,
    letter: u8,
}

/// Adds the floor, the tower, and the ball on its way; returns what is drawn.
fn furnish(client: &mut Client) -> Result<Vec<Drawn>, MainError> {
    client.add_body(BodyDesc::fixed(Shape::cuboid(50.0, 0.5, 50.0)).at(0.0, -0.5, 0.0))?;
    let tower = (0..BOXES).map(|i| {
        let height = HALF * (2.0 * f32::from(i) + 1.0);
        BodyDesc::dynamic(Shape::cuboid(HALF, HALF, HALF)).at(0.0, height, 0.0)
    });
    let tower = client.add_bodies(tower)?;
    let ball = BodyDesc::dynamic(Shape::ball(RADIUS)).at(-8.0, 2.0, 0.0);
    let ball = client.add_body(ball.linear_velocity(Vec3::new(12.0, 4.0, 0.0)))?;
    let boxes = tower.into_iter().zip(b'A'..);
    let mut drawn: Vec<_> = boxes.map(|(id, letter)| Drawn { id, letter }).collect();
    drawn.push(Drawn {
        id: ball,
        letter: b'o',
    });
    Ok(drawn)
}

/// True if a body of the picture covers a point, seen from the side.
fn covers(body: &Drawn, at: Vec3, turned: Quat, point: Vec3) -> bool {
    let point = turned.inverse() * (point.with_z(at.z) - at);
    match body.letter {
        b'o' => point.length() <= RADIUS,
        _ => point.abs().max_element() <= HALF,
    }
}

/// The scene from the side, as lines of text.
fn picture(client: &Client, drawn: &[Drawn]) -> String {
    let view = client.view();
    let pose = |body: &Drawn| Some((view.position(body.id)?, view.rotation(body.id)?));
    let poses: Vec<_> = drawn.iter().map(|body| (body, pose(body))).collect();
    let letter_at = |point: Vec3| {
        let mut covering = poses.iter().filter(|(body, pose)| {
            pose.is_some_and(|(at, turned)| covers(body, at, turned, point))
        });
        covering
            .next()
            .map_or(' ', |(body, _)| char::from(body.letter))
    };
    let mut text = String::new();
    for row in (0..ROWS).rev() {
        let height = 0.5 * row as f32 + 0.25;
        let line = (0..COLUMNS).map(|column| {
            let across = 0.25 * (column as f32 - COLUMNS as f32 / 2.0) + 0.125;
            letter_at(Vec3::new(across, height, 0.0))
        });
        text.push_str(line.collect::<String>().trim_end());
        text.push('\n');
    }
    text.push_str(&"=".repeat(COLUMNS));
    text.push('\n');
    text
}

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments
        .next()
        .ok_or("the server's host:port is missing")?;
    let fingerprint = arguments.next().ok_or("its fingerprint is missing")?;
    let trust = Trust::Fingerprint(fingerprint.parse()?);
    let mut client = Client::connect(&address, trust)?.join("tower")?;
    let drawn = furnish(&mut client)?;
    let mut out = std::io::stdout();
    let is_terminal = out.is_terminal();
    for tick in 1..=TICKS {
        client.advance(PipelineDepth::LOCKSTEP)?;
        if tick == 1 || tick % TICKS_SHOWN == 0 {
            if is_terminal {
                // To the first line, over the picture before.
                write!(out, "\x1b[H\x1b[J")?;
                client.idle(STAYS)?;
            }
            writeln!(out, "{}tick {tick}", picture(&client, &drawn))?;
        }
    }
    let tops = drawn
        .iter()
        .filter_map(|body| client.view().position(body.id));
    let top = tops.map(|at| at.y).fold(0.0, f32::max);
    let received = client.statistics().wire.received_bytes;
    writeln!(
        out,
        "the highest of {BOXES} boxes is at {top:.1} m; {received} bytes were received"
    )?;
    Ok(client.delete()?)
}
