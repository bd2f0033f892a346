//! L2.51: a seat that changed hands while packets were missing.
//!
//! The ball leaves its seat, another body takes it, and the ball rests elsewhere. Then comes the packet that had seated the
//! ball first. Who puts it back there takes what was said of the other body for something that it knows already.

use core::num::NonZeroU32;

use rhumb_protocol::packet::{
    Age, Course, Low16, RepairRecord, RepairWriter, Saying, StateWriter, TrackSaying, Update,
};
use rhumb_protocol::stream::{Manner, Subscriber};
use rhumb_reckoning::{
    Anchor, BodyId, Class, Damping, Metres, Predictor, Residual, Tick, Ticks, Verbatim,
};

use super::{hand, table};
use crate::conformance::case::{Case, Row};
use crate::conformance::outcome::{Play, Stop, ensure};
use crate::conformance::peer::Host;
use crate::conformance::trial::Trial;
use crate::testee::bits;

const CASES: &[Row] = &[(
    45,
    "who was heard of since takes no seat that a late packet says",
    "PROTOCOL 6.6-11, 6.13-6, 6.13-7, 6.13-11, 6.13-12",
    late_seating,
)];

pub(super) fn cases() -> Vec<Case> {
    table("L2.51", CASES)
}

/// Who takes the ball's seat.
const OTHER: BodyId = BodyId::new(4, 0);
/// The tick behind all packets.
const LAST: u64 = hand::TICK + 7;
/// The packet of that tick, which never comes.
const NEVER: u64 = hand::NEXT + 6;

fn whole(predictor: Predictor, x: f32, speed: f32) -> TrackSaying {
    let linear = [speed, 0.0, 0.0];
    let motion = Verbatim::new([x, 10.0, 0.0], [0.0, 0.0, 0.0, 1.0], linear, [0.0; 3]);
    TrackSaying {
        predictor,
        anchor: Anchor::Verbatim(motion.expect("it is finite")),
        carrier: None,
    }
}

fn moving(x: f32) -> TrackSaying {
    whole(Predictor::Uniform, x, 2.0)
}

fn resting(x: f32) -> TrackSaying {
    whole(Predictor::Rest, x, 0.0)
}

/// What is said in six ticks, a packet in each.
fn packets() -> Vec<Vec<u8>> {
    let of = |seat, body: BodyId, whole| Update {
        seat,
        body: Some(body.index()),
        saying: Saying::Whole(whole),
    };
    let age = Age::of(Tick::new(2), Tick::new(4), NonZeroU32::MIN).expect("two ticks");
    let correction = Saying::Residual {
        course: Course::Same,
        age,
        residual: Residual {
            position: [3, 0, -2],
            turn: [0; 3],
            velocity: None,
        },
    };
    let said = [
        of(0, hand::BALL, moving(1.0)),
        of(0, hand::BALL, resting(2.0)),
        of(0, OTHER, moving(3.0)),
        of(1, hand::BALL, moving(4.0)),
        Update {
            seat: 0,
            body: None,
            saying: correction,
        },
        of(1, hand::BALL, resting(5.0)),
    ];
    let written = said.iter().zip(0..).map(|(update, place)| {
        let (number, tick) = (hand::NEXT + place, hand::TICK + 1 + place);
        let mut writer = StateWriter::new(hand::STREAM, number, tick, hand::NOTICES);
        assert!(writer.push(update), "a packet has room for one body");
        writer.finish(true)
    });
    written.collect()
}

/// What the stream is for who hears all of it in order.
fn truth(packets: &[Vec<u8>]) -> Subscriber {
    let mut truth = Subscriber::new(&hand::joined().start);
    let manner = Manner {
        radius: Metres::new(0.5),
        damping: Damping {
            linear: 0.0,
            angular: 0.0,
        },
        gravity_scale: 1.0,
        inertia: None,
        class: Class::USUAL,
    };
    for id in [hand::BALL, OTHER] {
        let rest = resting(0.0).track(Tick::new(hand::TICK - 1));
        assert!(
            truth.place(id, &manner, rest),
            "two bodies are not too many"
        );
    }
    truth.handle_snapshot_end();
    for packet in packets {
        truth.handle_datagram(packet);
    }
    truth
}

/// Makes a lost packet good at a tick; `record`: what its body does, if it spoke of one that is there.
fn repair(host: &mut Host, lost: u64, tick: u64, record: Option<RepairRecord>) -> Play {
    let mut writer = RepairWriter::default();
    record.iter().for_each(|record| writer.push(record));
    for datagram in writer.finish(hand::STREAM, lost, tick, hand::NOTICES) {
        host.throw(&datagram)?;
    }
    Ok(())
}

fn late_seating(trial: &mut Trial<'_>) -> Play {
    let packets = packets();
    let truth = truth(&packets);
    let mut host = trial.host()?;
    hand::wants_in(&mut host)?;
    let balls = [hand::BALL, OTHER].map(|id| hand::ball(id, Predictor::Rest));
    let [ball, other] = balls;
    hand::snapshot(&mut host, &[hand::shape(), ball, other]);
    hand::told(&mut host, "joined")?;
    for packet in &packets[3..] {
        host.throw(packet)?;
    }
    host.throw(&packets[0])?;
    let rests = RepairRecord {
        index: hand::BALL.index(),
        seat: None,
        age: Ticks::new(0),
        whole: resting(5.0),
    };
    repair(&mut host, hand::NEXT + 1, hand::TICK + 6, Some(rests))?;
    host.throw(&packets[2])?;
    // All is there now, but for what the client could not read and may ask for: then it has that too.
    hand::vouch(&mut host, NEVER + 1, LAST, hand::NOTICES)?;
    let asked = loop {
        let asked = hand::echo(&mut host)?.lost;
        if asked.contains(&Low16::of(NEVER)) {
            break asked;
        }
    };
    let gone = || Stop::Inconclusive("the suite has no such body".into());
    if asked.contains(&Low16::of(hand::NEXT + 4)) {
        let track = truth.track(OTHER).ok_or_else(gone)?;
        let goes_on = RepairRecord {
            index: OTHER.index(),
            seat: Some(0),
            age: Ticks::new(2),
            whole: TrackSaying::of(&track),
        };
        repair(&mut host, hand::NEXT + 4, LAST, Some(goes_on))?;
    }
    repair(&mut host, NEVER, LAST, None)?;
    let told = hand::told_tick(&mut host, LAST)?;
    let there = truth.believed(OTHER, Tick::new(LAST)).ok_or_else(gone)?;
    let believed = &told["moving"][hand::name(OTHER)];
    ensure(
        *believed == bits(&there),
        format!("it knows what the other body does, and does not hold {believed}"),
    )?;
    let sum = format!("{:016x}", truth.agreement());
    ensure(
        told["sum"] == sum,
        format!("its sum is {sum}, and not {}", told["sum"]),
    )
}
