//! L1.52: snapshots and scene events, and which of them a client must refuse.

use std::time::Duration;

use glam::{Quat, Vec3};
use rhumb_protocol::message::{ClientMessage, Joined, RemovalCause, SceneEvent, ServerMessage};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Joint, JointFrame, JointId, JointKind, Mesh, Shape, ShapeId,
};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{BodyId, BodyState, Predictor, Tick};

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{Delivery, RawServer, Setting};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = contradictions();
    cases.extend(malformed());
    cases.extend(pieces());
    cases.extend(table("L1.52", COUNTS));
    cases.extend(table("L1.52", UNREQUESTED));
    cases
}

/// Snapshots that the client did not ask for, and ends without a beginning.
const UNREQUESTED: &[CaseRow] = &[
    (
        10,
        "a snapshot that the client did not request begins a copy like any other",
        "PROTOCOL 3.2-4, 4.8-5",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            let later = hand::TICK + 5;
            let mut joined = hand::joined();
            joined.start.tick = Tick::new(later);
            // Of two beginnings the later one counts.
            server.send(&ServerMessage::Joined(joined.clone()));
            server.send(&ServerMessage::Joined(joined));
            let ball = hand::ball(hand::BALL, Predictor::Ballistic);
            server.send(&ServerMessage::SceneEvent(hand::shape()));
            server.send(&ServerMessage::SceneEvent(ball));
            server.send(&ServerMessage::SnapshotEnd);
            hand::reported_tick(&mut server, later)?;
            hand::watermark(&mut server, hand::NEXT, later + 1, hand::SCENE_EVENTS)?;
            hand::reported_tick(&mut server, later + 1).map(drop)
        },
    ),
    (
        11,
        "an end of a snapshot that has not begun ends the connection",
        "PROTOCOL 3.2-5",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            server.send(&ServerMessage::SnapshotEnd);
            server.must_be_closed(CloseCode::VIOLATION)
        },
    ),
    (
        12,
        "a scene event before the first snapshot ends the connection",
        "PROTOCOL 3.2-5",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::awaits_join(&mut server)?;
            server.send(&ServerMessage::SceneEvent(hand::shape()));
            server.must_be_closed(CloseCode::VIOLATION)
        },
    ),
    (
        13,
        "a snapshot before the welcome ends the connection",
        "PROTOCOL 3.2-5",
        |trial| {
            let mut server = trial.raw_server()?;
            server.await_message("hello", |message| {
                matches!(message, ClientMessage::Hello { .. }).then_some(())
            })?;
            hand::snapshot(&mut server, &[hand::shape()]);
            server.must_be_closed(CloseCode::VIOLATION)
        },
    ),
    (
        14,
        "a body of a shape that only the copy before had ends the connection",
        "PROTOCOL 3.2-4, 4.6-7",
        |trial| is_forgotten(trial, hand::ball(hand::BALL, Predictor::Rest)),
    ),
    (
        15,
        "the removal of a shape that only the copy before had ends the connection",
        "PROTOCOL 3.2-4, 4.6-7",
        |trial| is_forgotten(trial, SceneEvent::ShapeRemoved { id: hand::SHAPE }),
    ),
    (
        16,
        "the removal of a body that only the copy before had ends the connection",
        "PROTOCOL 3.2-4, 4.6-7",
        |trial| {
            let (id, cause) = (hand::BALL, RemovalCause::Command);
            is_forgotten(trial, SceneEvent::BodyRemoved { id, cause })
        },
    ),
];

/// Sends a second snapshot without the shape and the body of the first.
fn begins_anew(trial: &mut Trial<'_>) -> Result<RawServer, Stop> {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    let mut joined = hand::joined();
    let later = hand::TICK + 5;
    joined.start.tick = Tick::new(later);
    server.send(&ServerMessage::Joined(joined));
    server.send(&ServerMessage::SnapshotEnd);
    hand::watermark(&mut server, hand::NEXT, later + 1, hand::SCENE_EVENTS)?;
    hand::reported_tick(&mut server, later + 1)?;
    Ok(server)
}

/// Requires that a scene event names what the copy before had and this one has not.
fn is_forgotten(trial: &mut Trial<'_>, scene_event: SceneEvent) -> CaseResult {
    let mut server = begins_anew(trial)?;
    server.send(&ServerMessage::SceneEvent(scene_event));
    server.must_be_closed(CloseCode::VIOLATION)
}

/// Makes scene events.
type Producer = fn() -> Vec<SceneEvent>;

/// Scene events that contradict earlier ones.
const CONTRADICTIONS: [(&str, Producer); 8] = [
    ("a body whose shape does not exist", || {
        vec![of_shape(BodyId::new(9, 0), ShapeId(7))]
    }),
    ("the removal of a body that does not exist", || {
        vec![SceneEvent::BodyRemoved {
            id: BodyId::new(9, 0),
            cause: RemovalCause::Command,
        }]
    }),
    ("the removal of an earlier body with the same index", || {
        vec![SceneEvent::BodyRemoved {
            id: BodyId::new(3, 1),
            cause: RemovalCause::LeftWorld,
        }]
    }),
    ("the removal of a body twice", || {
        let removed = SceneEvent::BodyRemoved {
            id: hand::BALL,
            cause: RemovalCause::Command,
        };
        vec![removed.clone(), removed]
    }),
    ("the removal of a shape that does not exist", || {
        vec![SceneEvent::ShapeRemoved { id: ShapeId(7) }]
    }),
    ("a joint of a body that does not exist", || {
        vec![joint(JointId(1), BodyId::new(9, 0))]
    }),
    ("the removal of a joint that does not exist", || {
        vec![SceneEvent::JointRemoved { id: JointId(1) }]
    }),
    ("the removal of a joint that went with its body", || {
        let other = BodyId::new(4, 0);
        vec![
            hand::ball(other, Predictor::Rest),
            joint(JointId(1), other),
            SceneEvent::BodyRemoved {
                id: other,
                cause: RemovalCause::Command,
            },
            SceneEvent::JointRemoved { id: JointId(1) },
        ]
    }),
];

fn contradictions() -> Vec<Case> {
    let mut cases = Vec::new();
    for (place, (what, sent)) in CONTRADICTIONS.into_iter().enumerate() {
        let id = format!("L1.52.{}", place + 1);
        let name = format!("{what} ends the connection");
        let case = Case::client(&id, &name).cites("PROTOCOL 4.6-2, 4.6-7, 7-1");
        cases.push(case.play(move |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            sent()
                .into_iter()
                .for_each(|scene_event| server.send(&ServerMessage::SceneEvent(scene_event)));
            server.must_be_closed(CloseCode::VIOLATION)
        }));
    }
    cases
}

fn of_shape(id: BodyId, shape: ShapeId) -> SceneEvent {
    match hand::ball(id, Predictor::Rest) {
        SceneEvent::BodyPlaced {
            inertia,
            track,
            alias,
            ..
        } => SceneEvent::BodyPlaced {
            desc: BodyDesc::plain(id, BodyKind::Dynamic, shape),
            inertia,
            track,
            alias,
        },
        other => other,
    }
}

fn joint(id: JointId, other: BodyId) -> SceneEvent {
    let joint = Joint {
        kind: JointKind::Fixed,
        bodies: [hand::BALL, other],
        frames: [JointFrame::at(Vec3::ZERO); 2],
        collide: false,
        motors: [None; 6],
        strength: None,
    };
    SceneEvent::JointAdded { id, joint }
}

/// Numbers that no scene may contain.
fn malformed() -> Vec<Case> {
    type Producer = fn() -> Vec<u8>;
    let of: [(&str, &str, Producer); 7] = [
        ("a gravity of NaN in joined", "4.3-1", || {
            let mut joined = hand::joined();
            joined.start.gravity.x = f32::NAN;
            bytes_of(&ServerMessage::Joined(joined))
        }),
        ("an infinite gravity in joined", "4.3-1", || {
            let mut joined = hand::joined();
            joined.start.gravity.z = f32::INFINITY;
            bytes_of(&ServerMessage::Joined(joined))
        }),
        ("a change to a gravity of NaN", "4.3-1", || {
            let since = Tick::new(hand::TICK + 1);
            let gravity = Vec3::new(0.0, f32::NAN, 0.0);
            bytes_of(&ServerMessage::SceneEvent(SceneEvent::GravityChanged {
                since,
                gravity,
            }))
        }),
        ("a ball of radius zero", "4.6-1", || {
            let shape = Shape::Ball { radius: 0.0 };
            bytes_of(&ServerMessage::SceneEvent(SceneEvent::ShapeAdded {
                id: ShapeId(4),
                shape,
            }))
        }),
        ("a ball of radius NaN", "4.6-1", || {
            let shape = Shape::Ball { radius: f32::NAN };
            bytes_of(&ServerMessage::SceneEvent(SceneEvent::ShapeAdded {
                id: ShapeId(4),
                shape,
            }))
        }),
        ("a position of NaN", "2.6-29", || patched(NOT_A_NUMBER)),
        ("an infinite position", "2.6-29", || {
            patched(f32::INFINITY.to_le_bytes())
        }),
    ];
    let mut cases = Vec::new();
    for (place, (what, clause, sent)) in of.into_iter().enumerate() {
        let id = format!("L1.52.{}", place + 20);
        let name = format!("{what} is malformed");
        let cites = format!("PROTOCOL 2.5-3, {clause}; RECKONING 1.6-1");
        cases.push(Case::client(&id, &name).cites(&cites).play(move |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            server.send_bytes(&sent());
            server.must_be_closed(CloseCode::MALFORMED)
        }));
    }
    cases
}

const NOT_A_NUMBER: [u8; 4] = f32::NAN.to_le_bytes();

/// A placement of the ball with these bytes as its y coordinate.
fn patched(number: [u8; 4]) -> Vec<u8> {
    let mut bytes = bytes_of(&ServerMessage::SceneEvent(hand::ball(
        BodyId::new(4, 0),
        Predictor::Ballistic,
    )));
    let ten = 10.0_f32.to_le_bytes();
    let at = bytes.windows(4).position(|four| four == ten);
    if let Some(at) = at {
        bytes[at..at + 4].copy_from_slice(&number);
    }
    bytes
}

fn bytes_of(message: &ServerMessage) -> Vec<u8> {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    bytes
}

/// Messages that are longer than a piece.
fn pieces() -> Vec<Case> {
    vec![
        Case::client("L1.52.40", "a shape in several pieces is decoded")
            .cites("PROTOCOL 4.1-5, 4.1-7, 4.8-1")
            .play(|trial| {
                let mut server = trial.raw_server()?;
                hand::awaits_join(&mut server)?;
                let mesh = SceneEvent::ShapeAdded {
                    id: ShapeId(2),
                    shape: mesh(2_000)?,
                };
                hand::snapshot(
                    &mut server,
                    &[
                        mesh,
                        hand::shape(),
                        hand::ball(hand::BALL, Predictor::Ballistic),
                    ],
                );
                hand::reported(&mut server, "joined")?;
                hand::must_go_on(
                    &mut server,
                    hand::NEXT + 1,
                    hand::TICK + 1,
                    hand::SCENE_EVENTS,
                )
            }),
        refused_pieces(
            "L1.52.41",
            "a piece of another length is malformed",
            "4.1-8",
            || {
                let mut bytes = Vec::new();
                let body = vec![0; 100];
                bytes.extend([101, 0]);
                bytes.extend(body);
                bytes
            },
        ),
        refused_pieces(
            "L1.52.42",
            "a piece before an empty last part is malformed",
            "4.1-8",
            || {
                let mut bytes = piece();
                bytes.extend([1, 11]);
                bytes
            },
        ),
        refused_pieces("L1.52.43", "a length of zero is malformed", "4.1-1", || {
            vec![0]
        }),
        refused_pieces(
            "L1.52.44",
            "a message that is too long is malformed",
            "4.1-1",
            || vec![0x82, 0x80, 0x01, 11],
        ),
        refused_pieces(
            "L1.52.45",
            "pieces beyond the longest message are malformed",
            "4.1-7",
            || {
                let mut bytes: Vec<_> = (0..129).flat_map(|_| piece()).collect();
                bytes.extend([2, 11, 0]);
                bytes
            },
        ),
    ]
}

fn refused_pieces(id: &str, name: &str, clause: &str, sent: fn() -> Vec<u8>) -> Case {
    let case = Case::client(id, name).cites(&format!("PROTOCOL 2.5-3, {clause}"));
    case.play(move |trial| {
        let mut server = trial.raw_server()?;
        hand::admit(&mut server)?;
        let bytes = sent();
        server.wait_longer(trial.round_trips(bytes.len() as u64 / FLIGHT));
        server.connection.send_control(bytes);
        server.must_be_closed(CloseCode::MALFORMED)
    })
}

/// Bytes that a connection has under way at least, over a link that loses a packet in twenty: some nine packets.
const FLIGHT: u64 = 10_000;

/// A piece of exactly the required length.
fn piece() -> Vec<u8> {
    let mut bytes = vec![0x81, 0x80, 0x01, 0];
    bytes.resize(4 + 16_384, 0);
    bytes
}

/// A mesh with this number of points.
fn mesh(points: u16) -> Result<Shape, Stop> {
    let place = |point: u16| {
        let along = f32::from(point);
        Vec3::new(along * 0.01, (along * 0.1).sin(), f32::from(point % 7))
    };
    let places: Vec<_> = (0..points).map(place).collect();
    let triangles: Vec<_> = (2..u32::from(points))
        .map(|point| [point - 2, point - 1, point])
        .collect();
    let mesh = Mesh::new(&places, &triangles);
    let errs = |why| Stop::Inconclusive(format!("error of the suite: {why:?}"));
    mesh.map(Shape::Mesh).map_err(errs)
}

/// The scene event count, which orders control stream and datagrams.
const COUNTS: &[CaseRow] = &[
    (
        60,
        "a datagram that counts more scene events than were received waits for them",
        "PROTOCOL 1.2-1, 4.6-5, 4.6-6, 6.5-2, 6.1-3",
        waits_for_scene_events,
    ),
    (
        66,
        "a tick is not complete before the scene events that its packet counts",
        "PROTOCOL 4.6-6, 6.5-2",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            hand::watermark(
                &mut server,
                hand::NEXT,
                hand::TICK + 1,
                hand::SCENE_EVENTS + 1,
            )?;
            server.listen(Duration::from_millis(150))?;
            let early = server.lines_written()?;
            let early = early
                .iter()
                .any(|reported| reported["tick"] == hand::TICK + 1);
            ensure(!early, "it waits for the scene event")?;
            server.send_bytes(&[2, 11, 0x8a]);
            hand::reported_tick(&mut server, hand::TICK + 1).map(drop)
        },
    ),
    (
        61,
        "an unknown optional scene event changes nothing, but is counted",
        "PROTOCOL 3.5-6, 4.6-5, 4.6-6",
        unknown_scene_events,
    ),
    (
        62,
        "scene events of the snapshot are not counted",
        "PROTOCOL 4.8-3, 4.6-5",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            hand::watermark(&mut server, hand::NEXT, hand::TICK + 1, hand::SCENE_EVENTS)?;
            hand::reported_tick(&mut server, hand::TICK + 1).map(drop)
        },
    ),
    (
        63,
        "datagrams that come before the end of the snapshot are kept until then",
        "PROTOCOL 6.5-2, 6.11-3",
        before_the_end,
    ),
    (
        64,
        "bodies are placed, removed and placed again while a stream runs",
        "PROTOCOL 2.4-1, 2.4-2, 6.1-3, 6.3-5, 6.13-5, 4.6-2",
        placed_and_removed,
    ),
    (
        65,
        "deleting the scene ends the membership, not the connection",
        "PROTOCOL 3.3-2, 3.5-7",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            server.send(&ServerMessage::Deleted);
            hand::watermark(
                &mut server,
                hand::NEXT + 1,
                hand::TICK + 1,
                hand::SCENE_EVENTS,
            )?;
            server.listen(Duration::from_millis(150))?;
            ensure(
                server.ended.is_none() || server.ended_as(0),
                "it does not close with an error",
            )
        },
    ),
];

/// The control stream is delayed: packets about a body come before the body's placement.
fn waits_for_scene_events(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 40).after(5))?;
    interceptor.enter()?;
    let mut kept = Vec::new();
    interceptor.tamper(move |delivery| match delivery {
        Delivery::State(_) => vec![delivery],
        Delivery::Control(bytes) => {
            kept.extend(bytes);
            if kept.len() < 1_500 {
                return Vec::new();
            }
            vec![Delivery::Control(std::mem::take(&mut kept))]
        }
    });
    interceptor.step(40)?;
    // The last delayed scene event is released by the next one.
    interceptor.flush_control()?;
    interceptor.must_follow()
}

fn unknown_scene_events(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    hand::watermark(&mut server, hand::NEXT, hand::TICK + 2, hand::SCENE_EVENTS)?;
    hand::reported_tick(&mut server, hand::TICK + 2)?;
    server.send_bytes(&[4, 11, 0x8a, 1, 2]);
    server.send_bytes(&[2, 11, 0xfe]);
    hand::watermark(
        &mut server,
        hand::NEXT,
        hand::TICK + 3,
        hand::SCENE_EVENTS + 2,
    )?;
    hand::reported_tick(&mut server, hand::TICK + 3).map(drop)
}

fn before_the_end(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::awaits_join(&mut server)?;
    server.send(&ServerMessage::Joined(Joined { ..hand::joined() }));
    server.send(&ServerMessage::SceneEvent(hand::shape()));
    // A datagram of a stream that the client does not know yet would be dropped (6.5-3).
    server.listen(Duration::from_millis(100))?;
    hand::watermark(&mut server, hand::NEXT, hand::TICK + 1, hand::SCENE_EVENTS)?;
    server.listen(Duration::from_millis(50))?;
    server.send(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Ballistic,
    )));
    server.send(&ServerMessage::SnapshotEnd);
    hand::reported_tick(&mut server, hand::TICK + 1).map(drop)
}

fn placed_and_removed(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 6).after(30))?;
    interceptor.enter()?;
    let first = interceptor
        .mirror()?
        .bodies()
        .filter(|body| body.kind == BodyKind::Dynamic)
        .map(|body| body.id)
        .next();
    let Some(first) = first else {
        return Err(Stop::Inconclusive("no body can be removed".into()));
    };
    let shape = interceptor.mirror()?.body(first).map(|desc| desc.shape);
    interceptor.command(Command::RemoveBody { id: first })?;
    interceptor.step(5)?;
    let again = BodyId::new(first.index(), first.generation() + 1);
    let motion = BodyState::new(
        [0.0, 6.0, 0.0],
        Quat::IDENTITY.to_array(),
        [1.0, 0.0, 0.0],
        [0.0; 3],
    );
    let motion = motion.map_err(|_| Stop::Inconclusive("error of the suite".into()))?;
    interceptor.command(Command::AddBody {
        desc: BodyDesc::plain(again, BodyKind::Dynamic, shape.unwrap_or(ShapeId(0))),
        motion,
    })?;
    interceptor.step(20)?;
    interceptor.must_follow()
}
