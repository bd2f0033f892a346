//! Accepted datagrams: every form, every limit, and random packets.

use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::packet::{
    Age, ErrorScale, Keyframe, LossReport, Low16, PredictionMode, RefreshRecord, RefreshWriter,
    RepairSymbol, StreamId, Update, UpdatePayload, UpdateWriter, Watermark,
};
use rhumb_reckoning::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, Anchor, BodyId, BodyState, ConstantAcceleration,
    POSITION_LIMIT, Predictor, QuantisedState, RESIDUAL_LIMIT, Residual, RestCorrection,
    TRACK_AGE_MAX, TURN_LIMIT, Ticks, VELOCITY_LIMIT, VelocityResidual,
};

use crate::case::{NamedPacket, PacketRng};
use crate::document::CoveredPackets;
use crate::plain;

/// All accepted cases.
pub(crate) fn cases() -> Vec<NamedPacket> {
    let mut cases = Vec::new();
    empty(&mut cases);
    forms(&mut cases);
    limits(&mut cases);
    parents(&mut cases);
    accelerations(&mut cases);
    keyframes(&mut cases);
    random_packets(&mut cases);
    others(&mut cases);
    cases.extend(plain::accepted());
    cases
}

/// A packet of stream 5, the last of its tick.
pub(crate) fn packet(updates: &[Update]) -> Vec<u8> {
    let mut writer = UpdateWriter::new(StreamId(5), 70_000, 300, 12);
    for update in updates {
        assert!(writer.push(update), "the updates fit a packet");
    }
    writer.finish(true)
}

fn aliased(alias: u32, payload: UpdatePayload) -> Update {
    let body = matches!(payload, UpdatePayload::Keyframe(_)).then_some(alias + 100);
    Update {
        alias,
        body,
        payload,
    }
}

/// A correction without velocities, of a track with age nine.
pub(crate) const fn residual(
    mode: PredictionMode,
    position: [i32; 3],
    turn: [i32; 3],
) -> UpdatePayload {
    let residual = Residual {
        position,
        turn,
        velocity: None,
    };
    UpdatePayload::Residual {
        mode,
        age: Age::new(9),
        residual,
    }
}

/// Adds velocities. The size of the first component selects the exponent of the steps.
fn with_velocity(payload: UpdatePayload, linear: [i32; 3], angular: [i32; 3]) -> UpdatePayload {
    match payload {
        UpdatePayload::Residual {
            mode,
            age,
            mut residual,
        } => {
            residual.velocity = Some(VelocityResidual {
                velocity_exponent: match linear[0].unsigned_abs() {
                    small @ 0..1_000 => small % 10,
                    _ => 0,
                },
                linear,
                angular,
            });
            UpdatePayload::Residual {
                mode,
                age,
                residual,
            }
        }
        other => other,
    }
}

const fn aged(payload: UpdatePayload, age: u32) -> UpdatePayload {
    match payload {
        UpdatePayload::Residual { mode, residual, .. } => UpdatePayload::Residual {
            mode,
            age: Age::new(age),
            residual,
        },
        UpdatePayload::Resting {
            rest_correction, ..
        } => UpdatePayload::Resting {
            age: Age::new(age),
            rest_correction,
        },
        keyframe @ UpdatePayload::Keyframe(_) => keyframe,
    }
}

/// Rest at the exact pose, after a track with age nine.
const fn resting(position: [i32; 3], others: [i32; 3], largest: i32) -> UpdatePayload {
    UpdatePayload::Resting {
        age: Age::new(9),
        rest_correction: RestCorrection {
            negated: largest > 0,
            position,
            others,
            largest,
        },
    }
}

const fn world(predictor: Predictor, parent_age: Option<u32>) -> PredictionMode {
    PredictionMode::World {
        predictor,
        parent_age: match parent_age {
            Some(age) => Some(Age::new(age)),
            None => None,
        },
    }
}

const fn attached(parent: u32, age: u32) -> PredictionMode {
    PredictionMode::Attached {
        parent,
        parent_age: Age::new(age),
    }
}

fn quantised(rng: &mut PacketRng, predictor: Predictor) -> Keyframe {
    let quantised = QuantisedState {
        position: rng.triple(1 << 20),
        rotation: rng.rotation(),
        linear: rng.triple(1 << 10),
        angular: rng.triple(1 << 10),
    };
    Keyframe {
        predictor,
        anchor: Anchor::Quantised(if predictor == Predictor::Rest {
            quantised.stilled()
        } else {
            quantised
        }),
        parent: None,
    }
}

fn body_state(rng: &mut PacketRng, predictor: Predictor) -> Keyframe {
    let mut float = |most: u32| rng.triple(most).map(|steps| steps as f32 / 1_024.0);
    let (position, linear, angular) = (float(1 << 20), float(1 << 14), float(1 << 12));
    let body_state = BodyState::new(position, [0.6, 0.0, -0.8, 0.0], linear, angular)
        .expect("the state is valid");
    Keyframe {
        predictor,
        anchor: Anchor::Exact(if predictor == Predictor::Rest {
            body_state.stilled()
        } else {
            body_state
        }),
        parent: None,
    }
}

/// A keyframe at rest in the frame of another body.
pub(crate) fn attached_keyframe(rng: &mut PacketRng, parent: BodyId) -> Keyframe {
    Keyframe {
        parent: Some(parent),
        ..quantised(rng, Predictor::Rest)
    }
}

fn empty(cases: &mut Vec<NamedPacket>) {
    for (stream, number, tick, scene_events, ends) in [
        (0, 0, 0, 0, true),
        (300, 65_535, 65_536, 131_071, false),
        (u32::MAX, 1 << 40, 3, 4, true),
    ] {
        let writer = UpdateWriter::new(StreamId(stream), number, tick, scene_events);
        cases.push(("a packet without updates".to_owned(), writer.finish(ends)));
    }
}

/// One payload of each form.
pub(crate) fn every_form() -> Vec<UpdatePayload> {
    let mut rng = PacketRng::new(11);
    let mut all = Vec::new();
    let mut both = |mode| {
        let plain = residual(mode, [2, -1, 0], [0, 0, 1]);
        all.push(plain);
        if mode != world(Predictor::Rest, None) {
            all.push(with_velocity(plain, [0, -3, 0], [5, 0, 1]));
        }
    };
    both(PredictionMode::Same);
    for predictor in Predictor::ALL {
        both(world(predictor, None));
    }
    all.push(residual(attached(7, 3), [1, 1, -4], [0, -2, 1]));
    all.push(UpdatePayload::Keyframe(quantised(
        &mut rng,
        Predictor::TorqueFree,
    )));
    all.push(resting([12_000, -1, 0], [-300_000, 7, 1], 1));
    all
}

fn forms(cases: &mut Vec<NamedPacket>) {
    let all = every_form();
    for (place, payload) in all.iter().enumerate() {
        let name = format!("update {place} alone");
        cases.push((name, packet(&[aliased(3, *payload)])));
    }
    let in_order: Vec<_> = (0..)
        .zip(&all)
        .map(|(alias, s)| aliased(alias, *s))
        .collect();
    cases.push(("all forms in order".to_owned(), packet(&in_order)));
    let reversed: Vec<_> = (0..)
        .zip(all.iter().rev())
        .map(|(alias, s)| aliased(alias * 3, *s))
        .collect();
    cases.push(("all forms in reverse".to_owned(), packet(&reversed)));
    let taking: Vec<_> = (0..)
        .zip(&all)
        .map(|(alias, payload)| Update {
            alias,
            body: Some((alias * 7_919) % INDICES_MAX),
            payload: *payload,
        })
        .collect();
    cases.push(("all forms take aliases".to_owned(), packet(&taking)));
}

fn limits(cases: &mut Vec<NamedPacket>) {
    let plain = residual(PredictionMode::Same, [0; 3], [0; 3]);
    for age in [1, 2, 3, 5, 11, 31, TRACK_AGE_MAX.count(), 1 << 30] {
        let payload = aged(residual(PredictionMode::Same, [0, 3, -1], [1, 0, 0]), age);
        cases.push((
            format!("a track of age {age}"),
            packet(&[aliased(0, payload)]),
        ));
    }
    let far = i32::MAX;
    for (name, rest_correction) in [
        ("no steps at all", resting([0; 3], [0; 3], 0)),
        (
            "the longest steps",
            resting([far, -far, far], [-far, far, 0], -far),
        ),
    ] {
        cases.push((
            format!("a rest_correction of {name}"),
            packet(&[aliased(0, rest_correction)]),
        ));
    }
    for alias in [0, 1, 40, 5_000, INDICES_MAX - 1] {
        let name = format!("alias {alias}");
        cases.push((name, packet(&[aliased(alias, plain)])));
    }
    let far = [
        Update {
            alias: 4,
            body: Some(INDICES_MAX - 1),
            payload: plain,
        },
        Update {
            alias: INDICES_MAX - 1,
            body: Some(0),
            payload: plain,
        },
    ];
    cases.push((
        "aliases far apart, for the first and the last body".to_owned(),
        packet(&far),
    ));
    for size in [1, 2, 3, 4, 7, 8, 16, 17, 18, 19, 255, 4_095, 4_096] {
        let payload = residual(PredictionMode::Same, [0, -size, 0], [1, 0, -1]);
        let again = residual(PredictionMode::Same, [size, size, -size], [0, 2, 0]);
        let updates = [aliased(0, payload), aliased(1, again), aliased(2, again)];
        cases.push((format!("positions of {size} steps"), packet(&updates)));
    }
    let (p, t, v) = (RESIDUAL_LIMIT, TURN_LIMIT, VELOCITY_LIMIT);
    let greatest = with_velocity(
        residual(PredictionMode::Same, [p, -p, p], [t, -t, t]),
        [v, -v, v],
        [-v, v, -v],
    );
    cases.push((
        "the greatest correction".to_owned(),
        packet(&[aliased(0, greatest), aliased(1, greatest)]),
    ));
}

fn parents(cases: &mut Vec<NamedPacket>) {
    for age in [0, 1, 60, 1 << 30] {
        for mode in [
            attached(INDICES_MAX - 1, age),
            world(Predictor::BallisticTorqueFree, Some(age)),
        ] {
            let payload = residual(mode, [1, 0, 0], [0, 0, -1]);
            cases.push((
                format!("a parent's track of age {age}"),
                packet(&[aliased(2, payload)]),
            ));
        }
    }
    let payload = |parent| residual(attached(parent, 3), [0, 1, 0], [0; 3]);
    let updates: Vec<_> = (0..)
        .zip([5, 5, 6, 5, 5, 0])
        .map(|(alias, parent)| aliased(alias, payload(parent)))
        .collect();
    cases.push(("parents named and named again".to_owned(), packet(&updates)));
}

fn accelerations(cases: &mut Vec<NamedPacket>) {
    let most = ACCELERATION_LIMIT;
    let all = [
        ([0, 0, 0], 0),
        ([1, -1, 0], 3),
        ([16, 17, -18], 5),
        ([-300, 0, 7], 4),
        ([most, -most, most], ACCELERATION_EXPONENT_MAX),
    ];
    let payloads = all.map(|(steps, exponent)| {
        let push = ConstantAcceleration::new(steps, exponent).expect("it is within the limits");
        residual(world(Predictor::Accelerated(push), None), [1, 0, 0], [0; 3])
    });
    for (payload, (steps, _)) in payloads.into_iter().zip(all) {
        let name = format!("a push of {steps:?} steps");
        cases.push((name, packet(&[aliased(0, payload)])));
    }
    let updates: Vec<_> = (0..)
        .zip(payloads)
        .map(|(alias, s)| aliased(alias, s))
        .collect();
    cases.push((
        "accelerations one after another".to_owned(),
        packet(&updates),
    ));
}

/// Keyframes of every predictor and kind of anchor.
fn every_keyframe() -> Vec<Keyframe> {
    let mut rng = PacketRng::new(12);
    let mut all = Vec::new();
    for predictor in Predictor::ALL {
        all.push(quantised(&mut rng, predictor));
        if predictor.acceleration().is_none() {
            all.push(body_state(&mut rng, predictor));
        }
    }
    for parent in [BodyId::new(0, 0), BodyId::new(INDICES_MAX - 1, u16::MAX)] {
        all.push(attached_keyframe(&mut rng, parent));
    }
    let (p, v) = (POSITION_LIMIT, VELOCITY_LIMIT);
    all.push(Keyframe {
        predictor: Predictor::Uniform,
        anchor: Anchor::Quantised(QuantisedState {
            position: [p, -p, p],
            rotation: rng.rotation(),
            linear: [v, -v, v],
            angular: [-v, v, -v],
        }),
        parent: None,
    });
    all
}

fn keyframes(cases: &mut Vec<NamedPacket>) {
    let all = every_keyframe();
    for (place, keyframe) in all.iter().enumerate() {
        let name = format!("keyframe track {place}");
        cases.push((
            name,
            packet(&[aliased(0, UpdatePayload::Keyframe(*keyframe))]),
        ));
    }
    let updates: Vec<_> = (0..)
        .zip(&all)
        .map(|(alias, keyframe)| aliased(alias * 2, UpdatePayload::Keyframe(*keyframe)))
        .collect();
    cases.push((
        "keyframe tracks one after another".to_owned(),
        packet(&updates),
    ));
}

/// A random update as a scene may have it.
fn random_update(rng: &mut PacketRng, alias: u32, most: u32) -> Update {
    let forms = every_form();
    let payload = match rng.below(20) {
        0 => forms[rng.below(forms.len() as u32) as usize],
        1 => with_velocity(
            residual(
                PredictionMode::Same,
                rng.triple(most),
                rng.triple(most.min(1 << 10)),
            ),
            rng.triple(most),
            rng.triple(most),
        ),
        2 => residual(
            attached(rng.below(9), rng.below(200)),
            rng.triple(most),
            [0; 3],
        ),
        _ => residual(
            PredictionMode::Same,
            rng.triple(most),
            rng.triple(most.min(1 << 10)),
        ),
    };
    let payload = aged(payload, 1 + rng.signed(1_000).unsigned_abs());
    let taking = rng.below(12) == 0;
    let body =
        (taking || matches!(payload, UpdatePayload::Keyframe(_))).then(|| rng.below(INDICES_MAX));
    Update {
        alias,
        body,
        payload,
    }
}

fn random_packets(cases: &mut Vec<NamedPacket>) {
    for seed in 1..=24 {
        let mut rng = PacketRng::new(seed);
        let (count, most) = (1 + rng.below(20), 1 << rng.below(13));
        let mut alias = 0;
        let mut updates = Vec::new();
        for _ in 0..count {
            alias += rng.signed(40).unsigned_abs();
            updates.push(random_update(&mut rng, alias, most));
            alias += 1;
        }
        cases.push((
            format!("{count} updates by rng, seed {seed}"),
            packet(&updates),
        ));
    }
    for most in [1, 40] {
        let (mut rng, mut alias) = (PacketRng::new(99), 0);
        let mut writer = UpdateWriter::new(StreamId(5), 7, 8, 9);
        while writer.push(&random_update(&mut rng, alias, most)) {
            alias += 1;
        }
        let name = format!("a full packet, of {} updates", writer.count());
        cases.push((name, writer.finish(false)));
    }
    let mut writer = UpdateWriter::new(StreamId(5), 7, 8, 9);
    let mut alias = 0;
    while writer.push(&aliased(
        alias,
        residual(PredictionMode::Same, [0, 1, 0], [0; 3]),
    )) {
        alias += 1;
    }
    cases.push((
        format!("{} equal updates", writer.count()),
        writer.finish(true),
    ));
}

/// Repair symbols over packets of updates.
pub(crate) fn covered() -> Vec<CoveredPackets> {
    let mut rng = PacketRng::new(11);
    let mut packets = Vec::new();
    for number in 69_990_u64..70_010 {
        let age = Age::new(1 + rng.below(9));
        let residual = Residual::default();
        let accepted = UpdatePayload::Residual {
            mode: PredictionMode::Same,
            age,
            residual,
        };
        let mut writer = UpdateWriter::new(StreamId(5), number, number / 2, 12);
        for alias in 0..=rng.below(30) {
            assert!(
                writer.push(&aliased(2 * alias, accepted)),
                "the updates fit"
            );
        }
        packets.push((number, writer.finish(number % 3 != 0)));
    }
    let repair_symbol = |row: u8, places: &[usize]| {
        let packets: Vec<_> = places.iter().map(|place| packets[*place].clone()).collect();
        let slices: Vec<_> = packets.iter().map(|(n, bytes)| (*n, &bytes[..])).collect();
        let repair_symbol = RepairSymbol::of(row, &slices).expect("each packet has updates");
        let repair_symbol = repair_symbol.encode(StreamId(5));
        CoveredPackets {
            repair_symbol,
            packets,
        }
    };
    vec![
        repair_symbol(0, &[0]),
        repair_symbol(0, &[1, 2]),
        repair_symbol(127, &[3, 5, 8]),
        repair_symbol(64, &(0..20).collect::<Vec<_>>()),
    ]
}

/// Datagrams of a stream whose budget does not suffice.
fn over_budget(cases: &mut Vec<NamedPacket>) {
    for share in [1.01, 2.0, 3.3, 1e9, 4_026_531_840.0, 1e30] {
        let error_scale = ErrorScale::covering(share);
        let silence = Watermark {
            next: Low16(5),
            tick: Low16(6),
            scene_events: Low16(7),
        };
        let name = "a watermark over budget".to_owned();
        cases.push((name, silence.encode_over_budget(StreamId(5), error_scale)));
        let mut writer = UpdateWriter::new(StreamId(5), 70_000, 300, 12);
        let keyframe = every_keyframe()[0];
        assert!(writer.push(&Update {
            alias: 3,
            body: Some(9),
            payload: UpdatePayload::Keyframe(keyframe),
        }));
        let name = "a packet over budget".to_owned();
        cases.push((name, writer.finish_over_budget(error_scale)));
    }
}

fn others(cases: &mut Vec<NamedPacket>) {
    for case in covered() {
        cases.push(("a repair symbol".to_owned(), case.repair_symbol));
    }
    let empty = RepairSymbol {
        last: Low16::of(70_000),
        covered: 1,
        row: 7,
        sums: Vec::new(),
    };
    let name = "a repair symbol without bytes".to_owned();
    cases.push((name, empty.encode(StreamId(5))));
    for (next, tick, scene_events) in [(0, 0, 0), (70_001, 301, 12)] {
        let low = |count| Low16::of(count);
        let watermark = Watermark {
            next: low(next),
            tick: low(tick),
            scene_events: low(scene_events),
        };
        cases.push(("a watermark".to_owned(), watermark.encode(StreamId(5))));
    }
    over_budget(cases);
    for (repair_symbols, lost) in [
        (0, vec![]),
        (1, vec![Low16(1)]),
        (32, (0..64).map(Low16).collect()),
    ] {
        let loss_report = LossReport {
            next: Low16(70),
            abandoned: Low16(300),
            repair_symbols,
            lost,
        };
        cases.push(("a loss report".to_owned(), loss_report.encode(StreamId(5))));
    }
    let mut refresh = |name: &str, records: &[RefreshRecord]| {
        let mut writer = RefreshWriter::default();
        for record in records {
            writer.push(record);
        }
        for datagram in writer.finish(StreamId(5), 69_998, 301, 12) {
            cases.push((name.to_owned(), datagram));
        }
    };
    refresh("a refresh of nothing", &[]);
    let all = every_keyframe();
    let record = |place: u32, age| RefreshRecord {
        index: place * place,
        alias: (!place.is_multiple_of(3)).then_some(place * 5),
        age: Ticks::new(age),
        keyframe: all[place as usize % all.len()],
    };
    refresh("a refresh of one body", &[record(5, 4)]);
    let last = RefreshRecord {
        index: INDICES_MAX - 1,
        alias: Some(INDICES_MAX - 1),
        ..record(0, 1 << 30)
    };
    refresh("a refresh of the last body", &[last]);
    let many: Vec<_> = (0..60).map(|place| record(place, place * 9)).collect();
    refresh("a part of a refresh", &many);
}
