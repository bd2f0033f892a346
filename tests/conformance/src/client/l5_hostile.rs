//! L5.51: hostile servers, and clients that display only valid states.

use std::time::Duration;

use rhumb_protocol::Instant;
use rhumb_protocol::limits::{ANGULAR_MAX, COORDINATE_MAX, LINEAR_MAX};
use rhumb_protocol::message::{FaultCause, SceneEvent, ServerMessage};
use rhumb_protocol::packet::UpdatePayload;
use rhumb_protocol::packet::{FullPacket, FullRecord, Keyframe, Low16, Update, UpdateWriter};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{Anchor, BodyId, BodyState, ConstantAcceleration, Predictor, Tick};

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, ensure};
use crate::peer::{Setting, datagram};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = table("L5.51", CASES);
    for (place, (what, motion)) in greatest().into_iter().enumerate() {
        let id = format!("L5.51.{}", 20 + place);
        let name = format!("{what} at the edge of the range is accepted unchanged");
        cases.push(
            Case::client(&id, &name)
                .cites("PROTOCOL 5.5-2, 7-1; RECKONING 1.6-1")
                .play(move |trial| {
                    let mut server = trial.raw_server()?;
                    hand::admit(&mut server)?;
                    server.send_datagram(&keyframe_packet(motion))?;
                    let reported = hand::reported_tick(&mut server, hand::TICK + 1)?;
                    let (name, wanted) = (hand::name(hand::BALL), digits(motion));
                    let shown = &reported["moving"][&name];
                    ensure(
                        *shown == wanted,
                        format!("it displays {wanted} as received, not {shown}"),
                    )
                }),
        );
    }
    cases
}

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "random bytes on the control stream end the connection, and nothing else",
        "PROTOCOL 2.5-1, 2.5-3",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            let mut dice = trial.dice();
            // A message of a known type whose fields are all invalid.
            let mut bytes = vec![0xff, 0x7f, 3];
            bytes.extend((0..16_400).map(|_| 0x80 | dice.below(128) as u8));
            server.connection.send_control(bytes);
            server.must_be_closed(CloseCode::MALFORMED)?;
            server.must_exit()
        },
    ),
    (
        2,
        "a flood of malformed datagrams leaves the copy unchanged",
        "PROTOCOL 2.5-4, 6.5-1",
        flood,
    ),
    (
        3,
        "a motion with NaN is never displayed",
        "PROTOCOL 5.5-6, 5.12-2; RECKONING 1.6-1",
        not_a_number,
    ),
    (
        4,
        "a rotation that is not of unit length is refused",
        "PROTOCOL 5.12-2; RECKONING 1.6-1",
        not_of_unit_length,
    ),
    (
        5,
        "a prediction far ahead stays finite",
        "RECKONING 1.6-1, 3.1-1, 3.9-2",
        far_ahead,
    ),
    (
        6,
        "nonsensical clock values change nothing in the copy",
        "PROTOCOL 4.9-6",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            for (sent, tick) in [(0, 0), (u64::MAX, 1 << 48), (1 << 60, 3)] {
                server.send(&ServerMessage::Pong {
                    sent: Instant::from_nanos(sent),
                    tick: Tick::new(tick),
                    since_tick_ns: u64::MAX,
                });
            }
            hand::must_go_on(
                &mut server,
                hand::NEXT + 1,
                hand::TICK + 1,
                hand::SCENE_EVENTS,
            )
        },
    ),
    (
        7,
        "unrequested answers do no harm",
        "PROTOCOL 4.2-2, 4.2-3",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            server.send(&ServerMessage::Applied {
                through: 1 << 40,
                tick: Tick::new(3),
            });
            server.send(&ServerMessage::Created);
            hand::must_go_on(
                &mut server,
                hand::NEXT + 1,
                hand::TICK + 1,
                hand::SCENE_EVENTS,
            )
        },
    ),
    (
        8,
        "a faulted scene is displayed in its last state",
        "PROTOCOL 3.3-8, 6.3-6",
        |trial| {
            let mut server = trial.raw_server()?;
            hand::admit(&mut server)?;
            let tick = Tick::new(hand::TICK + 1);
            server.send(&ServerMessage::SceneEvent(SceneEvent::SceneFaulted {
                tick,
                cause: FaultCause::NoWayBack,
            }));
            hand::must_go_on(
                &mut server,
                hand::NEXT + 1,
                hand::TICK + 1,
                hand::SCENE_EVENTS + 1,
            )
        },
    ),
];

/// Motions with the greatest numbers that a command may contain.
fn greatest() -> Vec<(&'static str, BodyState)> {
    let body_state = |position: f32, linear: f32, angular: f32| {
        // No negative zero: a prediction adds to the position, and may turn it into a positive zero.
        let position = [position, 0.0 - position, 0.0];
        let no_turn = [0.0, 0.0, 0.0, 1.0];
        BodyState::new(position, no_turn, [linear; 3], [angular; 3]).expect("finite numbers")
    };
    vec![
        ("a position", body_state(COORDINATE_MAX, 0.0, 0.0)),
        ("a speed", body_state(0.0, LINEAR_MAX, 0.0)),
        ("a spin", body_state(0.0, 0.0, ANGULAR_MAX)),
        (
            "everything",
            body_state(-COORDINATE_MAX, -LINEAR_MAX, -ANGULAR_MAX),
        ),
    ]
}

/// A packet with a keyframe of the ball.
fn keyframe_packet(motion: BodyState) -> Vec<u8> {
    let mut writer =
        UpdateWriter::new(hand::STREAM, hand::NEXT, hand::TICK + 1, hand::SCENE_EVENTS);
    let payload = Keyframe {
        predictor: Predictor::Ballistic,
        anchor: Anchor::Exact(motion),
        parent: None,
    };
    let fits = writer.push(&Update {
        alias: 0,
        body: Some(hand::BALL.index()),
        payload: UpdatePayload::Keyframe(payload),
    });
    assert!(fits, "one body fits into a packet");
    writer.finish(true)
}

/// A motion, with its rotation normalised, in the form of a client's report: each number widened to a double.
fn digits(motion: BodyState) -> String {
    let widened = motion.parts().map(f64::from);
    let digits = widened.map(|number| format!("{:016x}", number.to_bits()));
    digits.concat()
}

/// True if each double of each motion is finite.
fn is_finite(reported: &serde_json::Value) -> bool {
    let motions = reported["moving"].as_object().into_iter().flatten();
    motions
        .filter_map(|(_, motion)| motion.as_str())
        .all(|motion| {
            motion.as_bytes().chunks(16).all(|digits| {
                let digits = std::str::from_utf8(digits).unwrap_or_default();
                u64::from_str_radix(digits, 16).is_ok_and(|bits| f64::from_bits(bits).is_finite())
            })
        })
}

fn flood(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 12))?;
    interceptor.enter()?;
    let mut dice = trial.dice();
    for round in 0..20 {
        for _ in 0..100 {
            let length = 1 + dice.below(200);
            let mut bytes: Vec<_> = (0..length).map(|_| dice.below(256) as u8).collect();
            bytes[0] = bytes[0] & 0xf0 | datagram::NO_KINDS[dice.below(4)];
            interceptor.raw_server.send_datagram(&bytes)?;
        }
        if round % 5 == 0 {
            interceptor.step(2)?;
        }
    }
    interceptor.step(10)?;
    interceptor.must_follow()
}

/// A full packet of one record with other bytes for y and w.
fn full(number: u64, tick: u64, y: [u8; 4], w: [u8; 4]) -> Vec<u8> {
    let five = 5.5_f32;
    let motion = BodyState::new([1.0, five, 2.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    let records = motion.map(|motion| FullRecord {
        index: hand::BALL.index(),
        motion,
    });
    let packet = FullPacket {
        number: Low16::of(number),
        tick: Low16::of(tick),
        scene_events: Low16::of(hand::SCENE_EVENTS),
        ends_tick: true,
        records: records.into_iter().collect(),
    };
    let mut bytes = packet.encode(hand::STREAM);
    for (before, after) in [(five.to_le_bytes(), y), (1.0_f32.to_le_bytes(), w)] {
        // Only the last match: the rotation's w is 1, and so is the first coordinate of the position.
        if let Some(at) = bytes.windows(4).rposition(|four| four == before) {
            bytes[at..at + 4].copy_from_slice(&after);
        }
    }
    bytes
}

/// The record is not a valid motion; the keyframe_packet packet is dropped, and is missing when the next one comes.
fn dropped_whole(trial: &mut Trial<'_>, y: [u8; 4], w: [u8; 4]) -> CaseResult {
    let mut server = trial.raw_server_for("subscribe full")?;
    hand::awaits_join(&mut server)?;
    let mut joined = hand::joined();
    joined.choice = rhumb_protocol::message::StreamChoice::Full;
    server.send(&ServerMessage::Joined(joined));
    server.send(&ServerMessage::SceneEvent(hand::shape()));
    server.send(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Uniform,
    )));
    server.send(&ServerMessage::SnapshotEnd);
    hand::reported(&mut server, "joined")?;
    server.send_datagram(&full(hand::NEXT, hand::TICK + 1, y, w))?;
    hand::must_go_on(
        &mut server,
        hand::NEXT + 1,
        hand::TICK + 2,
        hand::SCENE_EVENTS,
    )?;
    for reported in server.lines_written()? {
        ensure(is_finite(&reported), "each displayed number is finite")?;
        let tick = reported["tick"].as_u64().unwrap_or_default();
        ensure(
            tick <= hand::TICK,
            format!("it ignores the packet and does not report tick {tick}"),
        )?;
    }
    Ok(())
}

fn not_a_number(trial: &mut Trial<'_>) -> CaseResult {
    let one = 1.0_f32.to_le_bytes();
    for y in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        dropped_whole(trial, y.to_le_bytes(), one)?;
    }
    Ok(())
}

fn not_of_unit_length(trial: &mut Trial<'_>) -> CaseResult {
    let y = 5.5_f32.to_le_bytes();
    for w in [0.0_f32, 0.5, 2.0, f32::NAN] {
        dropped_whole(trial, y, w.to_le_bytes())?;
    }
    Ok(())
}

fn far_ahead(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::awaits_join(&mut server)?;
    let predictors = [
        Predictor::Uniform,
        Predictor::Ballistic,
        Predictor::BallisticTorqueFree,
        Predictor::Accelerated(ConstantAcceleration::SAMPLE),
    ];
    let mut scene_events = vec![hand::shape()];
    let balls = predictors
        .into_iter()
        .zip(3..)
        .map(|(predictor, index)| hand::ball(BodyId::new(index, 0), predictor));
    scene_events.extend(balls);
    hand::snapshot(&mut server, &scene_events);
    hand::reported(&mut server, "joined")?;
    for tick in [1, 2, 60, 1_022] {
        hand::watermark(
            &mut server,
            hand::NEXT,
            hand::TICK + tick,
            hand::SCENE_EVENTS,
        )?;
        let reported = hand::reported_tick(&mut server, hand::TICK + tick)?;
        ensure(
            is_finite(&reported),
            format!("each number is finite after {tick} ticks"),
        )?;
        let count = reported["moving"]
            .as_object()
            .map_or(0, serde_json::Map::len);
        ensure(
            count == predictors.len(),
            format!("it reports {} bodies, not {count}", predictors.len()),
        )?;
    }
    server.listen(Duration::from_millis(20))?;
    ensure(server.ended.is_none(), "the connection stays open")
}
