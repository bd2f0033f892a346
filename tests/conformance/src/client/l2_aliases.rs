//! L2.51: an alias that was reassigned while packets were missing.
//!
//! The ball loses its alias to another body, and then comes to rest under no alias. Then the packet comes that had
//! assigned the alias to the ball first. A client that applies this assignment would take updates of the other body
//! for old data.

use core::num::NonZeroU32;

use rhumb_protocol::packet::{
    Age, Keyframe, Low16, PredictionMode, RefreshRecord, RefreshWriter, Update, UpdatePayload,
    UpdateWriter,
};
use rhumb_protocol::stream::{PredictionParameters, Subscriber};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Metres, Predictor, Residual, Tick, Ticks, ToleranceScale,
};

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawServer;
use crate::testee::bits;
use crate::trial::Trial;

const CASES: &[CaseRow] = &[(
    45,
    "a late packet assigns no alias to a body that was updated since",
    "PROTOCOL 6.6-11, 6.13-6, 6.13-7, 6.13-11, 6.13-12",
    late_assignment,
)];

pub(super) fn cases() -> Vec<Case> {
    table("L2.51", CASES)
}

/// The body that takes over the ball's alias.
const OTHER: BodyId = BodyId::new(4, 0);
/// The tick of the last packet.
const LAST: u64 = hand::TICK + 7;
/// The packet of that tick, which is never sent.
const NEVER: u64 = hand::NEXT + 6;

fn keyframe(predictor: Predictor, x: f32, speed: f32) -> Keyframe {
    let linear = [speed, 0.0, 0.0];
    let motion = BodyState::new([x, 10.0, 0.0], [0.0, 0.0, 0.0, 1.0], linear, [0.0; 3]);
    Keyframe {
        predictor,
        anchor: Anchor::Exact(motion.expect("a finite motion")),
        parent: None,
    }
}

fn moving(x: f32) -> Keyframe {
    keyframe(Predictor::Uniform, x, 2.0)
}

fn resting(x: f32) -> Keyframe {
    keyframe(Predictor::Rest, x, 0.0)
}

/// Six packets, one for each tick.
fn packets() -> Vec<Vec<u8>> {
    let of = |alias, body: BodyId, keyframe| Update {
        alias,
        body: Some(body.index()),
        payload: UpdatePayload::Keyframe(keyframe),
    };
    let age =
        Age::of(Tick::new(2), Tick::new(4), NonZeroU32::MIN).expect("two ticks are a valid age");
    let correction = UpdatePayload::Residual {
        mode: PredictionMode::Same,
        age,
        residual: Residual {
            position: [3, 0, -2],
            turn: [0; 3],
            velocity: None,
        },
    };
    let sent = [
        of(0, hand::BALL, moving(1.0)),
        of(0, hand::BALL, resting(2.0)),
        of(0, OTHER, moving(3.0)),
        of(1, hand::BALL, moving(4.0)),
        Update {
            alias: 0,
            body: None,
            payload: correction,
        },
        of(1, hand::BALL, resting(5.0)),
    ];
    let written = sent.iter().zip(0..).map(|(update, place)| {
        let (number, tick) = (hand::NEXT + place, hand::TICK + 1 + place);
        let mut writer = UpdateWriter::new(hand::STREAM, number, tick, hand::SCENE_EVENTS);
        assert!(writer.push(update), "one body fits into a packet");
        writer.finish(true)
    });
    written.collect()
}

/// The subscriber state after all packets in order.
fn truth(packets: &[Vec<u8>]) -> Subscriber {
    let mut truth = Subscriber::new(&hand::joined().start);
    let parameters = PredictionParameters {
        radius: Metres::new(0.5),
        damping: Damping {
            linear: 0.0,
            angular: 0.0,
        },
        gravity_scale: 1.0,
        inertia: None,
        tolerance_scale: ToleranceScale::USUAL,
    };
    for id in [hand::BALL, OTHER] {
        let rest = resting(0.0).track(Tick::new(hand::TICK - 1));
        assert!(
            truth.place(id, &parameters, rest),
            "two aliases fit into the table"
        );
    }
    truth.handle_snapshot_end();
    for packet in packets {
        truth.handle_datagram(packet);
    }
    truth
}

/// Sends the refresh of a lost packet at a tick; `record`: the track of a body that the packet named, if it exists.
fn refresh(
    server: &mut RawServer,
    lost: u64,
    tick: u64,
    record: Option<RefreshRecord>,
) -> CaseResult {
    let mut writer = RefreshWriter::default();
    record.iter().for_each(|record| writer.push(record));
    for datagram in writer.finish(hand::STREAM, lost, tick, hand::SCENE_EVENTS) {
        server.send_datagram(&datagram)?;
    }
    Ok(())
}

fn late_assignment(trial: &mut Trial<'_>) -> CaseResult {
    let packets = packets();
    let truth = truth(&packets);
    let mut server = trial.raw_server()?;
    hand::awaits_join(&mut server)?;
    let balls = [hand::BALL, OTHER].map(|id| hand::ball(id, Predictor::Rest));
    let [ball, other] = balls;
    hand::snapshot(&mut server, &[hand::shape(), ball, other]);
    hand::reported(&mut server, "joined")?;
    for packet in &packets[3..] {
        server.send_datagram(packet)?;
    }
    server.send_datagram(&packets[0])?;
    let rests = RefreshRecord {
        index: hand::BALL.index(),
        alias: None,
        age: Ticks::new(0),
        keyframe: resting(5.0),
    };
    refresh(&mut server, hand::NEXT + 1, hand::TICK + 6, Some(rests))?;
    server.send_datagram(&packets[2])?;
    // All data has arrived now, except packets that the client could not decode and may report: the loop sends those
    // again.
    hand::watermark(&mut server, NEVER + 1, LAST, hand::SCENE_EVENTS)?;
    let asked = loop {
        let asked = hand::loss_report(&mut server)?.lost;
        if asked.contains(&Low16::of(NEVER)) {
            break asked;
        }
    };
    let no_body = || Stop::Inconclusive("the suite's subscriber has no such body".into());
    if asked.contains(&Low16::of(hand::NEXT + 4)) {
        let track = truth.track(OTHER).ok_or_else(no_body)?;
        let goes_on = RefreshRecord {
            index: OTHER.index(),
            alias: Some(0),
            age: Ticks::new(2),
            keyframe: Keyframe::of(&track),
        };
        refresh(&mut server, hand::NEXT + 4, LAST, Some(goes_on))?;
    }
    refresh(&mut server, NEVER, LAST, None)?;
    let reported = hand::reported_tick(&mut server, LAST)?;
    let there = truth
        .predicted_motion(OTHER, Tick::new(LAST))
        .ok_or_else(no_body)?;
    let reported_motion = &reported["moving"][hand::name(OTHER)];
    ensure(
        *reported_motion == bits(&there),
        format!("the client predicts the other body correctly, not {reported_motion}"),
    )?;
    let sum = format!("{:016x}", truth.state_checksum());
    ensure(
        reported["checksum"] == sum,
        format!("its checksum is {sum}, not {}", reported["checksum"]),
    )
}
