//! L0.2: long messages, which are sent in pieces.

use glam::Vec3;
use rhumb_protocol::limits::{LONG_MESSAGE_BYTES_MAX, MESSAGE_BYTES_MAX};
use rhumb_protocol::message::{ClientMessage, StreamChoice};
use rhumb_protocol::scene::{Command, Heights, Mesh, Shape, ShapeId};
use rhumb_protocol::session::CloseCode;

use super::scenery::lockstep;
use crate::case::Case;
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let refused = |id: &str, name: &str, cites: &str, bytes: fn() -> Vec<u8>| {
        Case::server(id, name).cites(cites).play(move |trial| {
            let mut client = member(trial)?;
            client.send_bytes(&bytes());
            client.must_be_closed(CloseCode::MALFORMED)
        })
    };
    let full = [7; MESSAGE_BYTES_MAX];
    vec![
        Case::server(
            "L0.2.1",
            "a height field of a hundred thousand heights is accepted in pieces",
        )
        .cites("PROTOCOL 4.1-5, 4.1-7, 2.6-7, 2.6-6")
        .needs(&[Feature::Sheets])
        .play(|trial| long(trial, &heights()?)),
        Case::server("L0.2.2", "a mesh of many triangles is accepted in pieces")
            .cites("PROTOCOL 4.1-5, 2.6-8")
            .needs(&[Feature::Sheets])
            .play(|trial| long(trial, &mesh()?)),
        refused(
            "L0.2.3",
            "a short piece is malformed",
            "PROTOCOL 4.1-8",
            || framed(0, &[1, 2, 3]),
        ),
        refused(
            "L0.2.4",
            "a piece before an empty last part is malformed",
            "PROTOCOL 4.1-8, 4.1-5",
            || [framed(0, &[7; MESSAGE_BYTES_MAX]), framed(9, &[])].concat(),
        ),
        refused(
            "L0.2.5",
            "another message between a piece and the next is malformed",
            "PROTOCOL 4.1-6",
            || [framed(0, &[7; MESSAGE_BYTES_MAX]), framed(10, &[1])].concat(),
        ),
        Case::server(
            "L0.2.6",
            "pieces with more bytes than the longest message are malformed",
        )
        .cites("PROTOCOL 4.1-7")
        .play(move |trial| {
            let mut client = member(trial)?;
            for _ in 0..=LONG_MESSAGE_BYTES_MAX / MESSAGE_BYTES_MAX {
                client.connection.send_control(framed(0, &full));
            }
            client.must_be_closed(CloseCode::MALFORMED)
        }),
        Case::server(
            "L0.2.7",
            "an unknown optional message of many pieces is skipped",
        )
        .cites("PROTOCOL 4.1-2, 4.1-5")
        .play(move |trial| {
            let mut client = member(trial)?;
            let pieces = [framed(0, &full), framed(0, &full), framed(0x9a, &[1])];
            client.connection.send_control(pieces.concat());
            let received = client.barrier()?;
            ensure(
                received.is_empty(),
                format!("it has no effect, not {received:?}"),
            )
        }),
    ]
}

fn member(trial: &mut Trial<'_>) -> Result<RawClient, Stop> {
    let mut client = trial.client()?;
    client.enter(lockstep(), StreamChoice::Full)?;
    Ok(client)
}

/// One message in a frame of its own.
fn framed(kind: u8, body: &[u8]) -> Vec<u8> {
    let mut length = body.len() + 1;
    let mut bytes = Vec::new();
    while length >= 0x80 {
        bytes.push(length as u8 | 0x80);
        length >>= 7;
    }
    bytes.push(length as u8);
    bytes.push(kind);
    bytes.extend_from_slice(body);
    bytes
}

/// Sends a command in pieces, and checks that its scene event reaches a late joiner too.
fn long(trial: &mut Trial<'_>, shape: &Shape) -> CaseResult {
    let mut client = member(trial)?;
    let command = Command::AddShape {
        id: ShapeId(3),
        shape: shape.clone(),
    };
    let mut bytes = Vec::new();
    ClientMessage::Command(command).encode(&mut bytes);
    ensure(
        bytes.len() > 2 * MESSAGE_BYTES_MAX,
        "the message needs several pieces",
    )?;
    for part in bytes.chunks(5_000) {
        client.connection.send_control(part.to_vec());
    }
    client.commands += 1;
    let applied = client.outcome_of(0)?;
    ensure(applied.is_ok(), format!("it is applied, not {applied:?}"))?;
    let mut late = trial.client_of(&client.scene.clone())?;
    late.hello()?;
    let (_, scene_events) = late.join(StreamChoice::Full)?;
    let is_it = |scene_event: &rhumb_protocol::message::SceneEvent| {
        matches!(
            scene_event,
            rhumb_protocol::message::SceneEvent::ShapeAdded { shape: reported, .. } if reported == shape
        )
    };
    ensure(
        scene_events.iter().any(is_it),
        "a late joiner receives the same shape",
    )
}

fn heights() -> Result<Shape, Stop> {
    let side = 300_u16;
    let heights: Vec<f32> = (0..u32::from(side) * u32::from(side))
        .map(|place| (place % 17) as f32 / 16.0)
        .collect();
    let heights = Heights::new(u32::from(side), 1.0, 0.5, &heights);
    heights
        .map(Shape::Heights)
        .map_err(|_| Stop::Inconclusive("the height field is invalid".into()))
}

fn mesh() -> Result<Shape, Stop> {
    let side = 40_u32;
    let place = |row: u32, column: u32| row * side + column;
    let points: Vec<Vec3> = (0..side * side)
        .map(|at| {
            Vec3::new(
                (at / side) as f32,
                ((at * 7) % 5) as f32 / 4.0,
                (at % side) as f32,
            )
        })
        .collect();
    let cells = (0..side - 1).flat_map(|row| (0..side - 1).map(move |column| (row, column)));
    let triangles: Vec<[u32; 3]> = cells
        .flat_map(|(row, column)| {
            let (a, b) = (place(row, column), place(row, column + 1));
            let (c, d) = (place(row + 1, column), place(row + 1, column + 1));
            [[a, b, c], [b, d, c]]
        })
        .collect();
    Mesh::new(&points, &triangles)
        .map(Shape::Mesh)
        .map_err(|_| Stop::Inconclusive("the mesh is invalid".into()))
}
