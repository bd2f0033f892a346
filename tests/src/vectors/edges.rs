//! Vectors at the edges of one rule each.
//!
//! The last numbers that pass, the first that do not, and which of several faults counts.

use rhumb_protocol::packet::Keyframe;
use rhumb_protocol::wire::bits::BitWriter;
use rhumb_reckoning::{Anchor, BodyState, Predictor};

use super::message_case::{Edge, MessageCase, edge};
use super::pieces::{UNIT, body, f, id, in_bits, motion, v};
use super::scene_edges::{configs, hulls, joint_edges, shape_edges};

fn case((rule, name, body): Edge, kind: u8, head: &[u8], of: &str) -> MessageCase {
    MessageCase {
        name: format!("{of}, {name}"),
        kind,
        body: [head, &body].concat(),
        rule: Some(rule),
    }
}

/// Messages that a client sends.
pub(super) fn client() -> Vec<MessageCase> {
    let of = |edges: Vec<Edge>, kind: u8, head: &[u8], of: &str| -> Vec<MessageCase> {
        let cases = edges.into_iter().map(|edge| case(edge, kind, head, of));
        cases.collect()
    };
    let shapes = [hulls(), shape_edges()].concat();
    [
        of(configs(), 2, &[], "Create"),
        of(shapes, 7, &[0, 1], "AddShape"),
        of(joint_edges(), 7, &[11, 7], "AddJoint"),
        of(additions(), 7, &[2], "AddBody"),
        of(changes(), 7, &[13], "ChangeBody"),
        of(commands(), 7, &[], "a command"),
        of(queries(), 17, &[], "Query"),
    ]
    .concat()
}

/// Messages that a server sends.
pub(super) fn server() -> Vec<MessageCase> {
    let of = |edges: Vec<Edge>, head: &[u8], of: &str| -> Vec<MessageCase> {
        // No answer says which of several faults is the first.
        let edges = edges.into_iter();
        let edges = edges.filter(|(rule, ..)| !["2.6-11", "4.5-3"].contains(rule));
        edges.map(|edge| case(edge, 11, head, of)).collect()
    };
    let shapes = [hulls(), shape_edges()].concat();
    [
        of(shapes, &[0, 1], "ShapeAdded"),
        of(joint_edges(), &[6, 7], "JointAdded"),
        of(tracks(), &[], "BodyPlaced"),
    ]
    .concat()
}

/// Commands with several faults, and rotations that are barely of unit length.
fn commands() -> Vec<Edge> {
    let vector = |code: u8, numbers: [f32; 3]| [vec![code], id(300, 2), f(&numbers)].concat();
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let mut edges = vec![
        edge(
            "4.5-1",
            "an impulse out of range, then NaN",
            vector(8, [2e9, nan, 0.0]),
        ),
        edge(
            "4.5-1",
            "an impulse that is NaN, then out of range",
            vector(8, [nan, 2e9, 0.0]),
        ),
        edge(
            "4.5-1",
            "an impulse out of range, then infinite",
            vector(8, [0.0, -2e9, inf]),
        ),
        edge(
            "4.5-1",
            "a force of minus infinity",
            vector(6, [0.0, -inf, 0.0]),
        ),
        edge("4.5-1", "the greatest force", vector(6, [1e9, -1e9, 1e9])),
    ];
    let turn = |bits: [u32; 4]| bits.map(f32::from_bits);
    for (name, bits) in UNIT {
        let pose = [vec![4], id(300, 2), f(&[0.0; 3]), f(&turn(bits))].concat();
        edges.push(edge("4.5-2", name, pose));
    }
    let pose = |position: [f32; 3], rotation: [f32; 4]| {
        [vec![4], id(300, 2), f(&position), f(&rotation)].concat()
    };
    edges.extend([
        edge(
            "4.5-2",
            "a rotation with a NaN",
            pose([0.0; 3], [0.0, nan, 0.0, 1.0]),
        ),
        edge(
            "4.5-3",
            "a position out of range with a rotation of no length",
            pose([2e5, 0.0, 0.0], [0.0; 4]),
        ),
        edge(
            "4.5-3",
            "a linear velocity out of range with an angular one that is NaN",
            [vec![5], id(300, 2), f(&[0.0, 1e4, 0.0, nan, 0.0, 0.0])].concat(),
        ),
        edge(
            "4.5-3",
            "a force out of range with a point that is NaN",
            [vec![15], id(300, 2), f(&[2e9, 0.0, 0.0]), f(&[nan; 3])].concat(),
        ),
    ]);
    edges
}

/// The beginning of a description with these flags.
fn plain(flags: u64) -> Vec<u8> {
    [id(300, 2), v(flags), v(1)].concat()
}

fn descriptions() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    [moments(), description_orders()].concat()
}

/// Descriptions of bodies with moments at their bounds.
fn moments() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let mass =
        |mass: f32, moments: [f32; 3]| [plain(257), f(&[mass]), vec![1], f(&moments)].concat();
    // One multiplication in f32 rounds the least moment down and the greatest up.
    let heavy = f32::from_bits(0x4272_8909);
    let (least, most) = (heavy * 1e-6, heavy * 1e8);
    // 1e-6 is not the f32 of GYRATION_MIN.
    let other = f32::from_bits(0x4286_031b);
    let (below, above) = (|x: f32| x.next_down(), |x: f32| x.next_up());
    let nan = f32::NAN;
    vec![
        (
            "2.6-14",
            "the least moment, rounded",
            mass(heavy, [least, 1.0, 1.0]),
        ),
        (
            "2.6-14",
            "below the least moment",
            mass(heavy, [1.0, below(least), 1.0]),
        ),
        (
            "2.6-14",
            "the greatest moment, rounded",
            mass(heavy, [1.0, most, most]),
        ),
        (
            "2.6-14",
            "above the greatest moment",
            mass(heavy, [above(most), 1.0, 1.0]),
        ),
        (
            "2.6-14",
            "a moment that exceeds the others by less than a thousandth",
            mass(1.0, [2.0015, 1.0, 1.0]),
        ),
        (
            "2.6-14",
            "a moment that exceeds the others by more",
            mass(1.0, [1.0, 2.003, 1.0]),
        ),
        (
            "2.6-14",
            "moments of no body, then a moment out of range",
            mass(1.0, [3.0, 1.0, 2e8]),
        ),
        (
            "2.6-14",
            "the least moment of an f32 bound",
            mass(other, [other * 1e-6, 1.0, 1.0]),
        ),
        (
            "2.6-14",
            "moments without a valid mass",
            mass(0.0, [nan, 1.0, 1.0]),
        ),
        (
            "2.6-14",
            "a moment out of range, then NaN",
            mass(1.0, [2e8, nan, 1.0]),
        ),
    ]
}

/// Descriptions of bodies with two faults that follow each other.
fn description_orders() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let (nan, material, damping) = (f32::NAN, f(&[0.5, 0.25, -1.0]), f(&[-1.0, 0.0]));
    vec![
        (
            "4.5-3",
            "a density and a damping out of range",
            [plain(13), material, damping.clone()].concat(),
        ),
        (
            "4.5-3",
            "a damping out of range, and a gravity scale that is NaN",
            [plain(25), damping, f(&[nan])].concat(),
        ),
        (
            "4.5-3",
            "a gravity scale out of range, and a mass that is NaN",
            [plain(273), f(&[101.0, nan]), vec![0]].concat(),
        ),
        (
            "4.5-3",
            "a mass out of range, and a sleep that is NaN",
            [plain(0x4101), f(&[0.0]), vec![0, 1], f(&[nan, 0.5, 2.0])].concat(),
        ),
        (
            "4.5-3",
            "a sleep of a speed out of range, with an angular one that is NaN",
            [plain(0x4001), vec![1], f(&[101.0, nan, 2.0])].concat(),
        ),
    ]
}

fn changes() -> Vec<Edge> {
    let edges = descriptions().into_iter();
    edges
        .map(|(rule, name, bytes)| edge(rule, name, bytes))
        .collect()
}

/// A motion of these parts.
fn motion_of(present: u8, numbers: &[f32]) -> Vec<u8> {
    [vec![present], f(numbers)].concat()
}

/// Motions with one fault or two.
fn faulty_motions() -> Vec<(&'static str, Vec<u8>)> {
    let nan = f32::NAN;
    vec![
        ("a position of NaN", motion_of(0, &[nan, 0.0, 0.0])),
        (
            "a rotation of no length",
            motion_of(1, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]),
        ),
        (
            "an infinite linear velocity",
            motion_of(2, &[0.0, 0.0, 0.0, f32::INFINITY, 0.0, 0.0]),
        ),
        (
            "an angular velocity of NaN",
            motion_of(4, &[0.0, 0.0, 0.0, 0.0, nan, 0.0]),
        ),
        (
            "a position of NaN, and a rotation of no length",
            motion_of(1, &[nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5]),
        ),
        (
            "a rotation of no length, and a linear velocity of NaN",
            motion_of(3, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, nan, 0.0, 0.0]),
        ),
        (
            "a rotation of NaN, and an infinite angular velocity",
            motion_of(
                5,
                &[0.0, 0.0, 0.0, nan, 0.0, 0.0, 1.0, 0.0, f32::INFINITY, 0.0],
            ),
        ),
        (
            "linear and angular velocities of NaN",
            motion_of(6, &[0.0, 0.0, 0.0, 0.0, nan, 0.0, nan, 0.0, 0.0]),
        ),
        (
            "a position and a linear velocity out of range",
            motion_of(2, &[2e5, 0.0, 0.0, 2e3, 0.0, 0.0]),
        ),
        (
            "a position out of range, and an angular velocity of NaN",
            motion_of(4, &[2e5, 0.0, 0.0, 0.0, nan, 0.0]),
        ),
    ]
}

/// New bodies whose motion is at fault, beside their description.
fn additions() -> Vec<Edge> {
    let faulty = [id(300, 2), v(9), v(1), f(&[-1.0, 0.0])].concat();
    let sound = body(300, 1);
    let mut edges = Vec::new();
    for (word, desc) in [
        ("a sound body", &sound),
        ("a damping out of range", &faulty),
    ] {
        for (fault, motion) in faulty_motions() {
            edges.push(edge(
                "2.6-29",
                format!("{word} with {fault}"),
                [desc, &motion[..]].concat(),
            ));
        }
    }
    for (name, bits) in UNIT {
        let turned = [vec![1], f(&[0.0; 3]), f(&bits.map(f32::from_bits))].concat();
        edges.push(edge("2.6-29", name, [&sound, &turned[..]].concat()));
    }
    // A motion at fault does not excuse what is malformed.
    let more = [&sound[..], &motion_of(0, &[f32::NAN, 0.0, 0.0]), &[0]].concat();
    edges.push(edge(
        "2.6-29",
        "a position of NaN, and a byte behind it",
        more,
    ));
    edges
}

/// Costs of messages.
fn queries() -> Vec<Edge> {
    let ray = |hits: u8| [vec![0], f(&[1.0, 2.0, 3.0, 0.0, -20.0, 0.0]), vec![0, hits]].concat();
    let cast = |hits: u8| {
        let shape = [vec![1, 0], f(&[0.5])].concat();
        let way = f(&[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 5.0, 0.0, 0.0]);
        [shape, way, vec![0, hits]].concat()
    };
    let all = |queries: &[Vec<u8>]| [v(queries.len() as u64), queries.concat()].concat();
    let rays = vec![ray(64); 64];
    let casts = [vec![cast(64); 6], vec![cast(25)], vec![ray(6)]].concat();
    let (one, far) = ([ray(1)], |numbers: [f32; 6]| {
        all(&[[vec![0], f(&numbers), vec![0, 1]].concat()])
    });
    vec![
        edge("4.14-3", "rays of the greatest cost", all(&rays)),
        edge(
            "4.14-3",
            "rays of one more",
            all(&[&rays[..], &one].concat()),
        ),
        edge("4.14-3", "casts of the greatest cost", all(&casts)),
        edge(
            "4.14-3",
            "casts of one more",
            all(&[&casts[..], &one].concat()),
        ),
        edge(
            "4.14-6",
            "an origin out of range with a translation of NaN",
            far([0.0, 2e5, 0.0, f32::NAN, 0.0, 0.0]),
        ),
        edge(
            "4.14-6",
            "an origin of NaN with a translation out of range",
            far([0.0, f32::NAN, 0.0, 2e5, 0.0, 0.0]),
        ),
        edge(
            "4.14-12",
            "a ray without a length",
            far([1.0, 2.0, 3.0, 0.0, -0.0, 0.0]),
        ),
        edge(
            "4.14-12",
            "a ray of the least length",
            far([1.0, 2.0, 3.0, 0.0, 0.0, f32::from_bits(1)]),
        ),
    ]
}

/// Tracks of placed bodies: keyframes in bits that are not of the form, and moving rests.
fn tracks() -> Vec<Edge> {
    let of = |keyframe: &[u8]| {
        let sized = [v(keyframe.len() as u64), keyframe.to_vec()].concat();
        [vec![2], body(300, 33), v(6), vec![0], sized, v(0)].concat()
    };
    let good = in_bits(Predictor::Rest, None);
    let good = &good[1..];
    let mut filled = good.to_vec();
    *filled.last_mut().expect("a keyframe has bytes") |= 0x80;
    let still = Keyframe {
        predictor: Predictor::Rest,
        anchor: Anchor::Exact(
            BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
                .expect("a state of finite numbers"),
        ),
        parent: None,
    };
    let mut bits = BitWriter::default();
    still.encode(&mut bits);
    let exact = bits.into_bytes();
    let mut edges = vec![
        edge("4.6-4", "a keyframe", of(good)),
        edge(
            "4.6-4",
            "a keyframe with a byte behind it",
            of(&[good, &[0]].concat()),
        ),
        edge(
            "4.6-4",
            "a keyframe without its last byte",
            of(&good[..good.len() - 1]),
        ),
        edge("4.6-4", "a keyframe that is filled with a one", of(&filled)),
        edge("4.6-4", "a keyframe with a body state", of(&exact)),
        edge("4.6-4", "no keyframe", of(&[])),
    ];
    let placed = |motion: Vec<u8>| [vec![2], body(300, 33), v(6), vec![8], motion, v(0)].concat();
    for present in [2, 4] {
        let name = format!("a rest with velocities {present}");
        edges.push(edge("4.6-4", name, placed(motion(present))));
    }
    for (name, bits) in UNIT {
        let turned = [vec![1], f(&[0.0; 3]), f(&bits.map(f32::from_bits))].concat();
        edges.push(edge("2.6-29", name, placed(turned)));
    }
    for (rule, name, desc) in descriptions() {
        let bytes = [vec![2], desc, vec![0], v(6), vec![8], motion(0), v(0)].concat();
        edges.push(edge(rule, name, bytes));
    }
    edges
}
