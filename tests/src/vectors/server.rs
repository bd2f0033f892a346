//! Vectors of server messages: every message, scene event, error and denial.

use rhumb_reckoning::{BodyId, ConstantAcceleration, Predictor};

use super::message_case::MessageCase;
use super::pieces::{
    CaseList, TURNED, bad_shapes, body, cell_places, choices, config, extensions, f, id, in_bits,
    joints, motion, shapes, v,
};

pub(super) fn cases() -> Vec<MessageCase> {
    let mut cases = CaseList::default();
    welcomes(&mut cases);
    for (kind, name) in [
        (2, "Created"),
        (4, "SnapshotEnd"),
        (5, "Left"),
        (6, "Deleted"),
    ] {
        cases.add(kind, name, &[]);
    }
    let sizes = [1_100; 5].into_iter().chain([699, 700, 1_150, 1_151]);
    for (size, (word, choice)) in sizes.zip(choices().into_iter().cycle()) {
        let start = [
            v(5),
            v(size),
            f(&[0.0, -9.81, 0.0]),
            v(300),
            v(70_000),
            v(12),
            v(4_096),
            v(4_096),
            v(2),
        ];
        let (config, more) = (config(0, false), extensions(&[]));
        let parts = [&choice[..], &config, &start.concat(), &more].concat();
        let bytes = if size == 1_100 {
            String::new()
        } else {
            format!(", packets of at most {size} bytes")
        };
        cases.add(3, format!("Joined, {word}{bytes}"), &[&parts]);
    }
    for (first, count) in [
        (0, 4_096),
        ((1 << 20) - 1, 1),
        (1 << 20, 0),
        ((1 << 20) - 1, 2),
    ] {
        let range = [v(first), v(count), v(7)].concat();
        cases.add(7, format!("Reserved, {count} from {first}"), &[&range]);
    }
    denials(&mut cases);
    cases.add(9, "Applied", &[&v(4), &v(299)]);
    errors(&mut cases);
    scene_events(&mut cases);
    cases.add(12, "Pong", &[&v(123_456_789_012), &v(300), &v(7_654_321)]);
    let numbers: Vec<u8> = (0..10).flat_map(|place| v(1 << (5 * place))).collect();
    cases.add(
        13,
        "Inspection",
        &[
            &v(300),
            &[1, 2, 3, 4, 5, 6, 7, 8],
            &v(500),
            &v(17),
            &numbers,
        ],
    );
    authority_answers(&mut cases);
    others(&mut cases);
    cases.0
}

/// Changes of tier, and unknown messages.
fn others(cases: &mut CaseList) {
    for (word, choice) in choices() {
        for cause in [0, 1, 2] {
            let name = format!("TierChanged, {word}, cause {cause}");
            cases.add(16, name, &[&choice, &[cause]]);
        }
    }
    query_results(cases);
    tick_events(cases);
    sessions(cases);
    cells(cases);
    cases.add_unknown(19);
}

/// News of cells.
fn cells(cases: &mut CaseList) {
    for (word, places) in cell_places() {
        let name = format!("OfCell, {word}, SnapshotEnd");
        cases.add(129, name, &[&places, &[1]]);
    }
    let (_, cell) = &cell_places()[0];
    let of_cell = |code: u8| [&cell[..], &[code]].concat();
    for (word, choice) in choices() {
        for (gravity, down) in [("", -9.81), (", gravity NaN", f32::NAN)] {
            let start = [
                v(5),
                v(1_100),
                f(&[0.0, down, 0.0]),
                v(300),
                v(70_000),
                v(12),
            ];
            let name = format!("OfCell, Joined, {word}{gravity}");
            cases.add(129, name, &[&of_cell(0), &choice, &start.concat()]);
        }
    }
    for code in [6, 0x7f, 0x80] {
        let name = format!("OfCell, Denied, {code}");
        cases.add(129, name, &[&of_cell(2), &[code]]);
    }
    let placed = [vec![2], body(300, 33), v(6), vec![8], motion(0), v(9)].concat();
    let heavy = [vec![2], body(300, 254), v(6), vec![8], motion(0), v(0)].concat();
    let removed = [vec![3], id(300, 2), vec![0]].concat();
    for (code, name) in [(3, "Placed"), (4, "Arrived")] {
        let of_body = [of_cell(code), id(70, 1)].concat();
        cases.add(129, format!("OfCell, {name}"), &[&of_body, &placed]);
        cases.add(
            129,
            format!("OfCell, {name}, flags 254"),
            &[&of_body, &heavy],
        );
        let name = format!("OfCell, {name}, a body that is removed");
        cases.add(129, name, &[&of_body, &removed]);
        cases.add(
            129,
            format!("OfCell, {code}, an optional event"),
            &[&of_body, &[0x9a]],
        );
    }
    cases.add(
        129,
        "OfCell, Departed",
        &[&of_cell(5), &id(300, 2), &v(300)],
    );
    cases.add(129, "OfCell, SceneEvent", &[&of_cell(6), &removed]);
    cases.add(
        129,
        "OfCell, SceneEvent, a placed body",
        &[&of_cell(6), &placed],
    );
    cases.add(
        129,
        "OfCell, SceneEvent, optional",
        &[&of_cell(6), &[0x9a, 1]],
    );
    cases.add(129, "OfCell, no such news", &[&of_cell(7)]);
}

fn query_results(cases: &mut CaseList) {
    let head = [v(4), v(300)].concat();
    let hit = |number: f32| [id(300, 2), f(&[number, 1.0, 2.0, 3.0, 0.0, 1.0, 0.0])].concat();
    let hits = [vec![0, 2], hit(0.0), hit(1.5)].concat();
    let (no_hits, bodies) = ([0, 0], [vec![1, 2], id(3, 0), id(300, 2)].concat());
    let all = [&[0, 3], &hits[..], &no_hits, &bodies].concat();
    cases.add(17, "QueryResult", &[&head, &all]);
    for (word, answer) in [
        (
            "a distance that is none",
            [vec![0, 1], hit(f32::NAN)].concat(),
        ),
        ("falling bodies", [vec![1, 2], id(3, 1), id(3, 0)].concat()),
        ("too many bodies", vec![1, 65]),
        ("no such answer", vec![2, 0]),
    ] {
        cases.add(
            17,
            format!("QueryResult, {word}"),
            &[&head, &[0, 1], &answer],
        );
    }
    for code in [1, 2] {
        let name = format!("QueryResult, outcome {code}");
        cases.add(17, name, &[&head, &[code, 0]]);
    }
    for code in [3, 4, 5, 6, 0x7f, 0x80, 0xff] {
        let name = format!("QueryResult, outcome {code}");
        cases.add(17, name, &[&head, &[code]]);
    }
}

fn tick_events(cases: &mut CaseList) {
    let pair = [id(3, 0), id(300, 2)].concat();
    let contact = [
        &pair[..],
        &f(&[1.0, 2.0, 3.0, 0.0, 1.0, 0.0, -0.01, 9_806.5]),
    ]
    .concat();
    let events: Vec<Vec<u8>> = (0..10)
        .map(|code| match code {
            0 | 2 => [&[code], &contact[..]].concat(),
            5..=9 => [&[code], &id(3, 0)[..]].concat(),
            _ => [&[code], &pair[..]].concat(),
        })
        .collect();
    cases.add(
        18,
        "TickEvents, one of each",
        &[&v(300), &v(0), &[10], &events.concat()],
    );
    cases.add(
        18,
        "TickEvents, only missed ones",
        &[&v(300), &v(70_000), &[0]],
    );
    cases.add(
        18,
        "TickEvents, no such event",
        &[&v(300), &v(0), &[1], &[10], &pair],
    );
    let infinite = [&pair[..], &f(&[f32::INFINITY; 8])].concat();
    cases.add(
        18,
        "TickEvents, an infinite contact",
        &[&v(300), &v(0), &[1, 0], &infinite],
    );
    for (word, count) in [("the most", 1_024), ("one too many", 1_025)] {
        let bytes = events[6].repeat(count);
        let name = format!("TickEvents, {word}");
        cases.add(18, name, &[&v(300), &v(0), &v(count as u64), &bytes]);
    }
}

/// The state of a resumed session, and what has become durable.
fn sessions(cases: &mut CaseList) {
    for flags in 0..=4 {
        let name = format!("Session, flags {flags}");
        cases.add(32, name, &[&[flags], &v(300), &v(7)]);
    }
    cases.add(33, "Durable", &[&v(300), &v(70_000)]);
    cases.add(33, "Durable, no tick", &[&v(300)]);
    let address = b"rhumb://10.0.0.2:4433";
    cases.add(128, "Moved", &[&v(21), address]);
    cases.add(128, "Moved, no address", &[&v(0)]);
    cases.add(128, "Moved, cut off", &[&v(22), address]);
    for (word, bytes) in [("the most", 768), ("one too many", 769)] {
        let name = format!("Moved, {word}");
        cases.add(128, name, &[&v(bytes as u64), &vec![b'a'; bytes]]);
    }
}

fn welcomes(cases: &mut CaseList) {
    for (word, versions) in [("", 1_u16), (", a version from the future", 2)] {
        let version = versions.to_le_bytes();
        cases.add(1, format!("Welcome, no scene{word}"), &[&version, &[0, 0]]);
        cases.add(
            1,
            format!("Welcome{word}"),
            &[&version, &[1], &config(1, true), &extensions(&[27])],
        );
    }
}

fn authority_answers(cases: &mut CaseList) {
    let granted = [id(3, 0), motion(0), id(300, 2), motion(7)].concat();
    cases.add(14, "AuthorityGrant none", &[&v(9), &v(300), &[0]]);
    cases.add(14, "AuthorityGrant two", &[&v(9), &v(300), &[2], &granted]);
    cases.add(
        14,
        "AuthorityGrant one twice",
        &[
            &v(9),
            &v(300),
            &[2],
            &id(3, 0),
            &motion(0),
            &id(3, 0),
            &motion(0),
        ],
    );
    for reason in 0..4 {
        cases.add(
            15,
            format!("AuthorityDenied, {reason}"),
            &[&[reason], &id(300, 2)],
        );
    }
    for reason in [4, 5, 6, 0x7f, 0x80, 0xff] {
        cases.add(15, format!("AuthorityDenied, {reason}"), &[&[reason]]);
    }
}

fn denials(cases: &mut CaseList) {
    for code in [
        0, 1, 4, 5, 6, 7, 8, 9, 10, 11, 12, 16, 17, 19, 0x7f, 0x80, 0xff,
    ] {
        cases.add(8, format!("Denied, {code}"), &[&[code]]);
    }
    for code in [2, 3] {
        for quantity in [0, 16, 25, 30, 31] {
            cases.add(
                8,
                format!("Denied, {code} {quantity}"),
                &[&[code, quantity]],
            );
        }
    }
    cases.add(8, "Denied, 18 for 5 seconds", &[&[18, 5]]);
}

fn errors(cases: &mut CaseList) {
    for code in [0, 1] {
        for quantity in 0..40 {
            cases.add(
                10,
                format!("Refused, {code} {quantity}"),
                &[&v(4), &[code, quantity]],
            );
        }
    }
    for code in [2, 4, 5, 10, 15, 16, 20, 23, 25, 26] {
        cases.add(
            10,
            format!("Refused, {code} of a body"),
            &[&v(4), &[code], &id(300, 2)],
        );
    }
    for code in [3, 6, 7, 12, 13, 14, 17, 24] {
        cases.add(
            10,
            format!("Refused, {code} of a shape or joint"),
            &[&v(4), &[code], &v(300)],
        );
    }
    for code in [
        8, 9, 11, 18, 19, 20, 21, 22, 27, 28, 29, 32, 33, 0x7f, 0x80, 0xff,
    ] {
        cases.add(10, format!("Refused, {code}"), &[&v(4), &[code]]);
    }
    cases.add(10, "Refused, 34 for 5 seconds", &[&v(4), &[34, 5]]);
    cases.add(10, "Refused, 35", &[&v(4), &[35]]);
    cases.add(10, "Refused, 36 for 1000 ms", &[&v(4), &[36], &v(1_000)]);
    cases.add(10, "Refused, 37", &[&v(4), &[37]]);
}

fn scene_events(cases: &mut CaseList) {
    for (word, shape) in shapes() {
        cases.add(11, format!("ShapeAdded, {word}"), &[&[0], &v(1), &shape]);
    }
    for (word, shape) in bad_shapes() {
        cases.add(11, format!("ShapeAdded, {word}"), &[&[0], &v(1), &shape]);
    }
    cases.add(
        11,
        "ShapeAdded, a flat hull",
        &[&[0], &v(1), &[4, 4], &f(&[0.0; 12])],
    );
    cases.add(11, "ShapeRemoved", &[&[1], &v(1)]);
    for flags in [0, 2, 4, 8, 16, 33, 60, 61, 66, 97, 129, 193, 254] {
        let name = format!("BodyPlaced, flags {flags}");
        cases.add(
            11,
            name,
            &[&[2], &body(300, flags), &v(6), &[8], &motion(0), &[0]],
        );
    }
    inertias(cases);
    tracks(cases);
    for cause in 0..4 {
        cases.add(
            11,
            format!("BodyRemoved, {cause}"),
            &[&[3], &id(300, 2), &[cause]],
        );
    }
    cases.add(
        11,
        "GravityChanged",
        &[&[4], &v(300), &f(&[0.0, -1.5, 0.0])],
    );
    for cause in 0..4 {
        cases.add(
            11,
            format!("SceneFaulted, {cause}"),
            &[&[5], &v(300), &[cause]],
        );
    }
    cases.add(11, "SceneRestored", &[&[8], &v(300)]);
    publishers(cases);
    for (word, joint) in joints() {
        cases.add(11, format!("JointAdded, {word}"), &[&[6], &v(7), &joint]);
    }
    cases.add(11, "JointRemoved", &[&[7], &v(7)]);
    for code in [9, 0x7f] {
        cases.add(
            11,
            format!("a critical scene event {code} that is unknown"),
            &[&[code, 1]],
        );
    }
    for code in [0x82, 0x9a, 0xff] {
        cases.add(
            11,
            format!("an optional scene event {code} that is unknown"),
            &[&[code, 1]],
        );
    }
}

fn publishers(cases: &mut CaseList) {
    for (code, name) in [(128, "PublisherSilent"), (129, "PublisherActive")] {
        let event = [vec![code], v(300)].concat();
        let (one, other) = (id(3, 1), id(300, 0));
        cases.add(11, name, &[&event, &v(2), &one, &other]);
        cases.add(11, format!("{name}, no bodies"), &[&event, &v(0)]);
        let backwards: [&[u8]; 4] = [&event, &v(2), &other, &one];
        cases.add(11, format!("{name}, bodies out of order"), &backwards);
        cases.add(
            11,
            format!("{name}, a body twice"),
            &[&event, &v(2), &one, &one],
        );
        cases.add(
            11,
            format!("{name}, too many bodies"),
            &[&event, &v(257), &one],
        );
    }
}

fn inertias(cases: &mut CaseList) {
    let tumbler = body(300, 1);
    let moments = f(&[1.0, 2.0, 2.5]);
    for (word, inertia) in [
        ("none", vec![0]),
        ("own axes", [vec![1], moments.clone()].concat()),
        ("a frame", [vec![2], moments.clone(), f(&TURNED)].concat()),
        ("equal moments", [vec![1], f(&[3.0; 3])].concat()),
        ("no moment", [vec![1], f(&[0.0, 1.0, 1.0])].concat()),
        (
            "a negative moment",
            [vec![1], f(&[-1.0, 1.0, 1.0])].concat(),
        ),
        (
            "moments too far apart",
            [vec![1], f(&[1e-9, 1.0, 1.0])].concat(),
        ),
        (
            "a frame that is none",
            [vec![2], moments, f(&[0.5; 3]), f(&[2.0])].concat(),
        ),
    ] {
        let name = format!("BodyPlaced, inertia: {word}");
        cases.add(
            11,
            name,
            &[&[2], &tumbler, &inertia, &v(6), &[8], &motion(0), &[0]],
        );
    }
}

fn tracks(cases: &mut CaseList) {
    let plain = body(300, 33);
    for predictor in 8..13_u8 {
        for present in 0..8 {
            let name = format!("BodyPlaced, body_state {predictor}, present {present}");
            cases.add(
                11,
                name,
                &[&[2], &plain, &v(6), &[predictor], &motion(present), &v(9)],
            );
        }
    }
    for code in [1, 7, 13, 15, 16, 0x80] {
        let name = format!("BodyPlaced, a track of no form {code}");
        cases.add(11, name, &[&[2], &plain, &v(6), &[code], &motion(0), &v(9)]);
    }
    let parent = Some(BodyId::new(7, 1));
    for (word, track) in [
        ("rest", in_bits(Predictor::Rest, None)),
        ("attached", in_bits(Predictor::Rest, parent)),
        ("uniform", in_bits(Predictor::Uniform, None)),
        ("ballistic", in_bits(Predictor::Ballistic, None)),
        ("torque_free", in_bits(Predictor::TorqueFree, None)),
        (
            "ballistic_torque_free",
            in_bits(Predictor::BallisticTorqueFree, None),
        ),
        (
            "constant_acceleration",
            in_bits(Predictor::Accelerated(ConstantAcceleration::SAMPLE), None),
        ),
    ] {
        let name = format!("BodyPlaced, quantised, {word}");
        cases.add(11, name, &[&[2], &plain, &v(6), &[0], &track, &v(0)]);
    }
}
