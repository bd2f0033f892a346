//! What publishers and subscribers say: every form, every limit, by chance.

use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::packet::{
    Age, Course, Echo, Excess, Low16, Parity, RepairRecord, RepairWriter, Saying, StateWriter,
    StreamId, TrackSaying, Update, Vouch,
};
use rhumb_reckoning::{
    Anchor, BodyId, DOUBLINGS_LIMIT, HORIZON, POSITION_LIMIT, PUSH_LIMIT, Predictor, Push,
    RESIDUAL_LIMIT, Residual, Settling, Snapped, TURN_LIMIT, Ticks, VELOCITY_LIMIT,
    VelocityResidual, Verbatim,
};

use crate::chance::Chance;
use crate::document::{Case, Covered};
use crate::plain;

/// All of them.
pub(crate) fn cases() -> Vec<Case> {
    let mut cases = Vec::new();
    empty(&mut cases);
    forms(&mut cases);
    limits(&mut cases);
    carriers(&mut cases);
    pushes(&mut cases);
    wholes(&mut cases);
    by_chance(&mut cases);
    others(&mut cases);
    cases.extend(plain::said());
    cases
}

/// A packet of stream 5, the last of its tick.
pub(crate) fn packet(updates: &[Update]) -> Vec<u8> {
    let mut writer = StateWriter::new(StreamId(5), 70_000, 300, 12);
    for update in updates {
        assert!(writer.push(update), "the updates fit a packet");
    }
    writer.finish(true)
}

fn seated(seat: u32, saying: Saying) -> Update {
    let body = matches!(saying, Saying::Whole(_)).then_some(seat + 100);
    Update { seat, body, saying }
}

/// A correction without velocities, of a track of nine ticks ago.
pub(crate) const fn residual(course: Course, position: [i32; 3], turn: [i32; 3]) -> Saying {
    let residual = Residual {
        position,
        turn,
        velocity: None,
    };
    Saying::Residual {
        course,
        age: Age::new(9),
        residual,
    }
}

/// In steps doubled as often as the first of them says.
fn with_velocity(saying: Saying, linear: [i32; 3], angular: [i32; 3]) -> Saying {
    match saying {
        Saying::Residual {
            course,
            age,
            mut residual,
        } => {
            residual.velocity = Some(VelocityResidual {
                coarseness: match linear[0].unsigned_abs() {
                    small @ 0..1_000 => small % 10,
                    _ => 0,
                },
                linear,
                angular,
            });
            Saying::Residual {
                course,
                age,
                residual,
            }
        }
        other => other,
    }
}

const fn aged(saying: Saying, age: u32) -> Saying {
    match saying {
        Saying::Residual {
            course, residual, ..
        } => Saying::Residual {
            course,
            age: Age::new(age),
            residual,
        },
        Saying::Settled { settling, .. } => Saying::Settled {
            age: Age::new(age),
            settling,
        },
        whole @ Saying::Whole(_) => whole,
    }
}

/// Rest to the bit, of a track of nine ticks ago.
const fn settled(position: [i32; 3], others: [i32; 3], largest: i32) -> Saying {
    Saying::Settled {
        age: Age::new(9),
        settling: Settling {
            negated: largest > 0,
            position,
            others,
            largest,
        },
    }
}

const fn world(predictor: Predictor, carrier_age: Option<u32>) -> Course {
    Course::World {
        predictor,
        carrier_age: match carrier_age {
            Some(age) => Some(Age::new(age)),
            None => None,
        },
    }
}

const fn held(carrier: u32, age: u32) -> Course {
    Course::Held {
        carrier,
        carrier_age: Age::new(age),
    }
}

fn snapped(chance: &mut Chance, law: Predictor) -> TrackSaying {
    let snapped = Snapped {
        position: chance.triple(1 << 20),
        rotation: chance.rotation(),
        linear: chance.triple(1 << 10),
        angular: chance.triple(1 << 10),
    };
    TrackSaying {
        predictor: law,
        anchor: Anchor::Snapped(if law == Predictor::Rest {
            snapped.stilled()
        } else {
            snapped
        }),
        carrier: None,
    }
}

fn verbatim(chance: &mut Chance, law: Predictor) -> TrackSaying {
    let mut float = |most: u32| chance.triple(most).map(|steps| steps as f32 / 1_024.0);
    let (position, linear, angular) = (float(1 << 20), float(1 << 14), float(1 << 12));
    let verbatim =
        Verbatim::new(position, [0.6, 0.0, -0.8, 0.0], linear, angular).expect("the motion is one");
    TrackSaying {
        predictor: law,
        anchor: Anchor::Verbatim(if law == Predictor::Rest {
            verbatim.stilled()
        } else {
            verbatim
        }),
        carrier: None,
    }
}

/// At rest in the frame of another body.
pub(crate) fn carried(chance: &mut Chance, carrier: BodyId) -> TrackSaying {
    TrackSaying {
        carrier: Some(carrier),
        ..snapped(chance, Predictor::Rest)
    }
}

fn empty(cases: &mut Vec<Case>) {
    for (stream, number, tick, notices, ends) in [
        (0, 0, 0, 0, true),
        (300, 65_535, 65_536, 131_071, false),
        (u32::MAX, 1 << 40, 3, 4, true),
    ] {
        let writer = StateWriter::new(StreamId(stream), number, tick, notices);
        cases.push(("a packet without updates".to_owned(), writer.finish(ends)));
    }
}

/// One saying of each form.
pub(crate) fn every_form() -> Vec<Saying> {
    let mut chance = Chance::new(11);
    let mut all = Vec::new();
    let mut both = |course| {
        let plain = residual(course, [2, -1, 0], [0, 0, 1]);
        all.push(plain);
        if course != world(Predictor::Rest, None) {
            all.push(with_velocity(plain, [0, -3, 0], [5, 0, 1]));
        }
    };
    both(Course::Same);
    for law in Predictor::ALL {
        both(world(law, None));
    }
    all.push(residual(held(7, 3), [1, 1, -4], [0, -2, 1]));
    all.push(Saying::Whole(snapped(&mut chance, Predictor::Tumbling)));
    all.push(settled([12_000, -1, 0], [-300_000, 7, 1], 1));
    all
}

fn forms(cases: &mut Vec<Case>) {
    let all = every_form();
    for (place, saying) in all.iter().enumerate() {
        let name = format!("form {place} alone");
        cases.push((name, packet(&[seated(3, *saying)])));
    }
    let in_order: Vec<_> = (0..).zip(&all).map(|(seat, s)| seated(seat, *s)).collect();
    cases.push(("all forms in order".to_owned(), packet(&in_order)));
    let reversed: Vec<_> = (0..)
        .zip(all.iter().rev())
        .map(|(seat, s)| seated(seat * 3, *s))
        .collect();
    cases.push(("all forms in reverse".to_owned(), packet(&reversed)));
    let taking: Vec<_> = (0..)
        .zip(&all)
        .map(|(seat, saying)| Update {
            seat,
            body: Some((seat * 7_919) % INDICES_MAX),
            saying: *saying,
        })
        .collect();
    cases.push(("all forms take seats".to_owned(), packet(&taking)));
}

fn limits(cases: &mut Vec<Case>) {
    let plain = residual(Course::Same, [0; 3], [0; 3]);
    for age in [1, 2, 3, 5, 11, 31, HORIZON.count(), 1 << 30] {
        let saying = aged(residual(Course::Same, [0, 3, -1], [1, 0, 0]), age);
        cases.push((
            format!("a track of age {age}"),
            packet(&[seated(0, saying)]),
        ));
    }
    let far = i32::MAX;
    for (name, settling) in [
        ("no steps at all", settled([0; 3], [0; 3], 0)),
        (
            "the longest steps",
            settled([far, -far, far], [-far, far, 0], -far),
        ),
    ] {
        cases.push((
            format!("a settling of {name}"),
            packet(&[seated(0, settling)]),
        ));
    }
    for seat in [0, 1, 40, 5_000, INDICES_MAX - 1] {
        let name = format!("seat {seat}");
        cases.push((name, packet(&[seated(seat, plain)])));
    }
    let far = [
        Update {
            seat: 4,
            body: Some(INDICES_MAX - 1),
            saying: plain,
        },
        Update {
            seat: INDICES_MAX - 1,
            body: Some(0),
            saying: plain,
        },
    ];
    cases.push((
        "seats far apart, for the first and the last body".to_owned(),
        packet(&far),
    ));
    for size in [1, 2, 3, 4, 7, 8, 16, 17, 18, 19, 255, 4_095, 4_096] {
        let saying = residual(Course::Same, [0, -size, 0], [1, 0, -1]);
        let again = residual(Course::Same, [size, size, -size], [0, 2, 0]);
        let updates = [seated(0, saying), seated(1, again), seated(2, again)];
        cases.push((format!("positions of {size} steps"), packet(&updates)));
    }
    let (p, t, v) = (RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT);
    let greatest = with_velocity(
        residual(Course::Same, [p, -p, p], [t, -t, t]),
        [v, -v, v],
        [-v, v, -v],
    );
    cases.push((
        "the greatest correction".to_owned(),
        packet(&[seated(0, greatest), seated(1, greatest)]),
    ));
}

fn carriers(cases: &mut Vec<Case>) {
    for age in [0, 1, 60, 1 << 30] {
        for course in [
            held(INDICES_MAX - 1, age),
            world(Predictor::Thrown, Some(age)),
        ] {
            let saying = residual(course, [1, 0, 0], [0, 0, -1]);
            cases.push((
                format!("a carrier's track of age {age}"),
                packet(&[seated(2, saying)]),
            ));
        }
    }
    let saying = |carrier| residual(held(carrier, 3), [0, 1, 0], [0; 3]);
    let updates: Vec<_> = (0..)
        .zip([5, 5, 6, 5, 5, 0])
        .map(|(seat, carrier)| seated(seat, saying(carrier)))
        .collect();
    cases.push((
        "carriers named and named again".to_owned(),
        packet(&updates),
    ));
}

fn pushes(cases: &mut Vec<Case>) {
    let most = PUSH_LIMIT;
    let all = [
        ([0, 0, 0], 0),
        ([1, -1, 0], 3),
        ([16, 17, -18], 5),
        ([-300, 0, 7], 4),
        ([most, -most, most], DOUBLINGS_LIMIT),
    ];
    let sayings = all.map(|(steps, doublings)| {
        let push = Push::new(steps, doublings).expect("it is within the limits");
        residual(world(Predictor::Pushed(push), None), [1, 0, 0], [0; 3])
    });
    for (saying, (steps, _)) in sayings.into_iter().zip(all) {
        let name = format!("a push of {steps:?} steps");
        cases.push((name, packet(&[seated(0, saying)])));
    }
    let updates: Vec<_> = (0..)
        .zip(sayings)
        .map(|(seat, s)| seated(seat, s))
        .collect();
    cases.push(("pushes one after another".to_owned(), packet(&updates)));
}

/// Tracks of every law and kind of anchor.
fn every_whole() -> Vec<TrackSaying> {
    let mut chance = Chance::new(12);
    let mut all = Vec::new();
    for law in Predictor::ALL {
        all.push(snapped(&mut chance, law));
        if law.push().is_none() {
            all.push(verbatim(&mut chance, law));
        }
    }
    for carrier in [BodyId::new(0, 0), BodyId::new(INDICES_MAX - 1, u16::MAX)] {
        all.push(carried(&mut chance, carrier));
    }
    let (p, v) = (POSITION_LIMIT, VELOCITY_LIMIT);
    all.push(TrackSaying {
        predictor: Predictor::Uniform,
        anchor: Anchor::Snapped(Snapped {
            position: [p, -p, p],
            rotation: chance.rotation(),
            linear: [v, -v, v],
            angular: [-v, v, -v],
        }),
        carrier: None,
    });
    all
}

fn wholes(cases: &mut Vec<Case>) {
    let all = every_whole();
    for (place, whole) in all.iter().enumerate() {
        let name = format!("whole track {place}");
        cases.push((name, packet(&[seated(0, Saying::Whole(*whole))])));
    }
    let updates: Vec<_> = (0..)
        .zip(&all)
        .map(|(seat, whole)| seated(seat * 2, Saying::Whole(*whole)))
        .collect();
    cases.push((
        "whole tracks one after another".to_owned(),
        packet(&updates),
    ));
}

/// Updates as a scene may have them.
fn chance_update(chance: &mut Chance, seat: u32, most: u32) -> Update {
    let forms = every_form();
    let saying = match chance.below(20) {
        0 => forms[chance.below(forms.len() as u32) as usize],
        1 => with_velocity(
            residual(
                Course::Same,
                chance.triple(most),
                chance.triple(most.min(1 << 10)),
            ),
            chance.triple(most),
            chance.triple(most),
        ),
        2 => residual(
            held(chance.below(9), chance.below(200)),
            chance.triple(most),
            [0; 3],
        ),
        _ => residual(
            Course::Same,
            chance.triple(most),
            chance.triple(most.min(1 << 10)),
        ),
    };
    let saying = aged(saying, 1 + chance.signed(1_000).unsigned_abs());
    let taking = chance.below(12) == 0;
    let body = (taking || matches!(saying, Saying::Whole(_))).then(|| chance.below(INDICES_MAX));
    Update { seat, body, saying }
}

fn by_chance(cases: &mut Vec<Case>) {
    for seed in 1..=24 {
        let mut chance = Chance::new(seed);
        let (count, most) = (1 + chance.below(20), 1 << chance.below(13));
        let mut seat = 0;
        let mut updates = Vec::new();
        for _ in 0..count {
            seat += chance.signed(40).unsigned_abs();
            updates.push(chance_update(&mut chance, seat, most));
            seat += 1;
        }
        cases.push((
            format!("{count} updates by chance, seed {seed}"),
            packet(&updates),
        ));
    }
    for most in [1, 40] {
        let (mut chance, mut seat) = (Chance::new(99), 0);
        let mut writer = StateWriter::new(StreamId(5), 7, 8, 9);
        while writer.push(&chance_update(&mut chance, seat, most)) {
            seat += 1;
        }
        let name = format!("a full packet, of {} updates", writer.count());
        cases.push((name, writer.finish(false)));
    }
    let mut writer = StateWriter::new(StreamId(5), 7, 8, 9);
    let mut seat = 0;
    while writer.push(&seated(seat, residual(Course::Same, [0, 1, 0], [0; 3]))) {
        seat += 1;
    }
    cases.push((
        format!("{} equal updates", writer.count()),
        writer.finish(true),
    ));
}

/// Parities over packets that say one thing to many.
pub(crate) fn covered() -> Vec<Covered> {
    let mut chance = Chance::new(11);
    let mut packets = Vec::new();
    for number in 69_990_u64..70_010 {
        let age = Age::new(1 + chance.below(9));
        let residual = Residual::default();
        let said = Saying::Residual {
            course: Course::Same,
            age,
            residual,
        };
        let mut writer = StateWriter::new(StreamId(5), number, number / 2, 12);
        for seat in 0..=chance.below(30) {
            assert!(writer.push(&seated(2 * seat, said)), "the updates fit");
        }
        packets.push((number, writer.finish(number % 3 != 0)));
    }
    let parity = |row: u8, places: &[usize]| {
        let packets: Vec<_> = places.iter().map(|place| packets[*place].clone()).collect();
        let slices: Vec<_> = packets.iter().map(|(n, bytes)| (*n, &bytes[..])).collect();
        let parity = Parity::of(row, &slices).expect("each packet says something");
        let parity = parity.encode(StreamId(5));
        Covered { parity, packets }
    };
    vec![
        parity(0, &[0]),
        parity(0, &[1, 2]),
        parity(127, &[3, 5, 8]),
        parity(64, &(0..20).collect::<Vec<_>>()),
    ]
}

/// What a stream with a budget says while that does not suffice.
fn in_arrears(cases: &mut Vec<Case>) {
    for share in [1.01, 2.0, 3.3, 1e9, 4_026_531_840.0, 1e30] {
        let excess = Excess::covering(share);
        let silence = Vouch {
            next: Low16(5),
            tick: Low16(6),
            notices: Low16(7),
        };
        let name = "a vouch in arrears".to_owned();
        cases.push((name, silence.encode_in_arrears(StreamId(5), excess)));
        let mut writer = StateWriter::new(StreamId(5), 70_000, 300, 12);
        let whole = every_whole()[0];
        assert!(writer.push(&Update {
            seat: 3,
            body: Some(9),
            saying: Saying::Whole(whole),
        }));
        let name = "a packet in arrears".to_owned();
        cases.push((name, writer.finish_in_arrears(excess)));
    }
}

fn others(cases: &mut Vec<Case>) {
    for case in covered() {
        cases.push(("a parity".to_owned(), case.parity));
    }
    for (next, tick, notices) in [(0, 0, 0), (70_001, 301, 12)] {
        let low = |count| Low16::of(count);
        let vouch = Vouch {
            next: low(next),
            tick: low(tick),
            notices: low(notices),
        };
        cases.push(("a vouch".to_owned(), vouch.encode(StreamId(5))));
    }
    in_arrears(cases);
    for (parities, lost) in [
        (0, vec![]),
        (1, vec![Low16(1)]),
        (32, (0..64).map(Low16).collect()),
    ] {
        let echo = Echo {
            next: Low16(70),
            gone: Low16(300),
            parities,
            lost,
        };
        cases.push(("an echo".to_owned(), echo.encode(StreamId(5))));
    }
    let mut repair = |name: &str, records: &[RepairRecord]| {
        let mut writer = RepairWriter::default();
        for record in records {
            writer.push(record);
        }
        for datagram in writer.finish(StreamId(5), 69_998, 301, 12) {
            cases.push((name.to_owned(), datagram));
        }
    };
    repair("a repair of nothing", &[]);
    let all = every_whole();
    let record = |place: u32, age| RepairRecord {
        index: place * place,
        seat: (!place.is_multiple_of(3)).then_some(place * 5),
        age: Ticks::new(age),
        whole: all[place as usize % all.len()],
    };
    repair("a repair of one body", &[record(5, 4)]);
    let last = RepairRecord {
        index: INDICES_MAX - 1,
        seat: Some(INDICES_MAX - 1),
        ..record(0, 1 << 30)
    };
    repair("a repair of the last body", &[last]);
    let many: Vec<_> = (0..60).map(|place| record(place, place * 9)).collect();
    repair("a part of a repair", &many);
}
