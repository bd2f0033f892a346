//! Building blocks of hand-made messages.

use core::f32::consts::{PI, TAU};

use rhumb_protocol::packet::Keyframe;
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::wire::bits::BitWriter;
use rhumb_reckoning::{Anchor, BodyId, PackedRotation, Predictor, QuantisedState};

use super::message_case::MessageCase;

/// A varint.
pub(super) fn v(mut number: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while number >= 0x80 {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

/// Floats.
pub(super) fn f(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|one| one.to_le_bytes()).collect()
}

/// A body id.
pub(super) fn id(index: u64, generation: u64) -> Vec<u8> {
    [v(index), v(generation)].concat()
}

pub(super) const TURNED: [f32; 4] = [0.5, -0.5, 0.5, 0.5];

/// Quaternions about the slack of 0.001, which is no f32: the last ones that pass, and ones that pass within an f32.
pub(super) const UNIT: [(&str, [u32; 4]); 4] = [
    (
        "a rotation that is barely not too long",
        [0x3f68_0944, 0x3ed9_4b0d, 0x3c96_ea33, 0x3a13_377a],
    ),
    (
        "a rotation that is barely too long",
        [0x3f4c_1b67, 0x3f14_f4ee, 0x3e2a_9d5e, 0x3934_32dd],
    ),
    (
        "a rotation that is barely not too short",
        [0x3f71_089f, 0x3eaa_3389, 0x3d01_36c8, 0x3b25_c6bf],
    ),
    (
        "a rotation that is barely too short",
        [0x3f67_5f3e, 0x3ed9_01ff, 0x3d1f_189f, 0x396b_a7ff],
    ),
];

/// A motion with the parts that `present` selects.
pub(super) fn motion(present: u8) -> Vec<u8> {
    let mut bytes = [vec![present], f(&[1.0, 2.5, -3.0])].concat();
    if present & 1 != 0 {
        bytes.extend(f(&TURNED));
    }
    if present & 2 != 0 {
        bytes.extend(f(&[0.0, -9.5, 0.25]));
    }
    if present & 4 != 0 {
        bytes.extend(f(&[3.0, 0.0, -0.0]));
    }
    bytes
}

/// The description of a body with the parts that `flags` selects.
pub(super) fn body(index: u64, flags: u64) -> Vec<u8> {
    let mut bytes = [id(index, 2), v(flags), v(1)].concat();
    if flags & 4 != 0 {
        bytes.extend(f(&[0.5, 0.25, 500.0]));
    }
    if flags & 8 != 0 {
        bytes.extend(f(&[0.125, 2.0]));
    }
    if flags & 16 != 0 {
        bytes.extend(f(&[-0.5]));
    }
    if flags & 64 != 0 {
        bytes.push(2);
    }
    if flags & 128 != 0 {
        bytes.push(0b10_0100);
    }
    if flags & 256 != 0 {
        bytes.extend([f(&[80.0]), vec![0]].concat());
    }
    if flags & 512 != 0 {
        bytes.extend([v(1), v(0xffff_fffe)].concat());
    }
    if flags & 1_024 != 0 {
        bytes.push(0xff);
    }
    if flags & 16_384 != 0 {
        bytes.extend([vec![1], f(&[0.25, 0.5, 2.0])].concat());
    }
    bytes
}

/// Descriptions of a dynamic body with the rarer properties, some of them malformed or outside the limits.
pub(super) fn properties() -> Vec<(&'static str, Vec<u8>)> {
    let plain = |flags: u64| [id(300, 2), v(flags), v(1)].concat();
    let moments = |parts: [f32; 3]| [plain(257), f(&[80.0]), vec![1], f(&parts)].concat();
    vec![
        ("plain", body(300, 1)),
        ("locked axes", body(300, 129)),
        ("mass", body(300, 257)),
        ("collision groups", body(300, 513)),
        ("dominance", body(300, 1_025)),
        ("sensor, swept, disabled", body(300, 0x3801)),
        ("sleep below", body(300, 0x4001)),
        ("sleep never", [plain(0x4001), vec![2]].concat()),
        ("sleep settled", [plain(0x4001), vec![0]].concat()),
        (
            "an unknown rule of sleep",
            [plain(0x4001), vec![3]].concat(),
        ),
        (
            "sleep below too great an angular speed",
            [plain(0x4001), vec![1], f(&[0.5, 101.0, 2.0])].concat(),
        ),
        ("everything", body(300, 0x7ffd)),
        ("a flag without meaning", plain(0x8001)),
        ("locked axes, none", [plain(129), vec![0]].concat()),
        ("a seventh locked axis", [plain(129), vec![64]].concat()),
        ("moments of inertia", moments([2.0, 2.5, 3.0])),
        ("moments below the least", moments([2.0, 2.5, 1e-5])),
        (
            "mass above the most",
            [plain(257), f(&[2e6]), vec![0]].concat(),
        ),
        (
            "mass with moments of another kind",
            [plain(257), f(&[1.0]), vec![2]].concat(),
        ),
        (
            "collision groups, all",
            [plain(513), v(0xffff_ffff), v(0xffff_ffff)].concat(),
        ),
        ("dominance of zero", [plain(1_025), vec![0]].concat()),
    ]
}

/// A scene's configuration; a free-running scene publishes every third tick, with lookahead.
pub(super) fn config(stepping: u8, sleep: bool) -> Vec<u8> {
    config_of(stepping, sleep, if stepping == 0 { [1, 0] } else { [3, 2] })
}

/// The same with this publish interval and lookahead.
pub(super) fn config_of(stepping: u8, sleep: bool, publish_schedule: [u64; 2]) -> Vec<u8> {
    let mut bytes = [v(60), v(1), v(4), f(&[0.0, -9.81, 0.0]), vec![stepping]].concat();
    bytes.extend(f(&[0.5, 0.25, 1_000.0, 0.0, 0.125]));
    if sleep {
        bytes.extend([vec![1], f(&[0.25, 0.5, 2.0])].concat());
    } else {
        bytes.push(0);
    }
    bytes.extend(publish_schedule.map(v).concat());
    bytes
}

/// Each shape with its name.
pub(super) fn shapes() -> [(&'static str, Vec<u8>); 13] {
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    [
        ("ball", [vec![0], f(&[0.5])].concat()),
        ("cuboid", [vec![1], f(&[0.5, 1.0, 2.0])].concat()),
        ("capsule", [vec![2], f(&[0.5, 0.25])].concat()),
        ("cylinder", [vec![3], f(&[0.5, 0.25])].concat()),
        ("hull", [vec![4, 4], f(&corners)].concat()),
        ("heights", heights([2, 3], [1.0, 0.5])),
        ("smooth mesh", smooth_mesh(&corners, &[0, 1, 2])),
        ("mesh", mesh(&corners, &[0, 1, 2, 3, 2, 1])),
        (
            "compound",
            compound(&[
                [vec![0], f(&[0.5])].concat(),
                mesh(&corners, &[0, 1, 2]),
                heights([3, 2], [1.0, 1.0]),
            ]),
        ),
        ("compound of nothing", compound(&[])),
        (
            "rounded cuboid",
            [vec![8], f(&[0.5, 1.0, 2.0, 0.25])].concat(),
        ),
        ("cone", [vec![9], f(&[0.5, 0.25])].concat()),
        ("half-space", [vec![10], f(&[0.0, 1.0, 0.0])].concat()),
    ]
}

/// A height field with these numbers of rows and columns.
pub(super) fn heights(counts: [u64; 2], spacings: [f32; 2]) -> Vec<u8> {
    let heights: Vec<f32> = (0..counts[0] * counts[1]).map(|n| n as f32 - 2.5).collect();
    [
        vec![5],
        counts.map(v).concat(),
        f(&spacings),
        vec![0],
        f(&heights),
    ]
    .concat()
}

/// A mesh from coordinates of points, and triangles as indices of points.
pub(super) fn mesh(coordinates: &[f32], places: &[u64]) -> Vec<u8> {
    let counts = [coordinates.len() as u64 / 3, places.len() as u64 / 3];
    let places: Vec<u8> = places.iter().flat_map(|place| v(*place)).collect();
    [
        vec![6],
        counts.map(v).concat(),
        vec![0],
        f(coordinates),
        places,
    ]
    .concat()
}

/// The same with smooth edges.
fn smooth_mesh(coordinates: &[f32], places: &[u64]) -> Vec<u8> {
    let mut bytes = mesh(coordinates, places);
    // The edges follow the kind and the two counts, each of one byte.
    bytes[3] = 1;
    bytes
}

/// A compound of these shapes, placed side by side.
pub(super) fn compound(parts: &[Vec<u8>]) -> Vec<u8> {
    let mut bytes = vec![7, parts.len() as u8];
    for (place, part) in parts.iter().enumerate() {
        bytes.extend(f(&[place as f32, -0.5, 0.0]));
        bytes.extend(f(&TURNED));
        bytes.extend(part);
    }
    bytes
}

/// Shapes that are malformed or that a server must refuse.
pub(super) fn bad_shapes() -> Vec<(&'static str, Vec<u8>)> {
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let ball = [vec![0], f(&[0.5])].concat();
    let unturned = [vec![7, 1], f(&[0.0; 7]), ball.clone()].concat();
    vec![
        ("heights of one row", heights([1, 4], [1.0, 1.0])),
        ("heights of one column", heights([4, 1], [1.0, 1.0])),
        (
            "heights of too many posts",
            [vec![5], v(512), v(513), f(&[1.0; 2]), vec![0], f(&[1.0; 4])].concat(),
        ),
        ("heights that are too long", heights([3, 2], [5_001.0, 1.0])),
        ("heights that are too wide", heights([2, 3], [1.0, 5_001.0])),
        ("the longest heights", heights([3, 2], [5_000.0, 1.0])),
        (
            "heights that are too long, with a spacing that is no number",
            heights([3, 2], [5_001.0, f32::NAN]),
        ),
        (
            "mesh with a point that is not, and one that is no number",
            mesh(&[f32::NAN; 9], &[0, 1, 3]),
        ),
        (
            "mesh with edges of an unknown kind",
            [vec![6], v(3), v(1), vec![2], f(&corners), v(0), v(1), v(2)].concat(),
        ),
        ("mesh of two points", mesh(&corners[..6], &[0, 1, 1])),
        ("mesh of no triangles", mesh(&corners, &[])),
        ("mesh with a point that is not", mesh(&corners, &[0, 1, 3])),
        (
            "mesh with a place that none has",
            mesh(&corners, &[0, 1, 65_537]),
        ),
        ("compound of a compound", compound(&[compound(&[])])),
        ("compound of the most", compound(&vec![ball.clone(); 64])),
        ("compound of one more", compound(&vec![ball; 65])),
        ("compound with a part of no rotation", unturned),
        (
            "half-space without direction",
            [vec![10], f(&[0.0; 3])].concat(),
        ),
    ]
}

/// Each kind of joint, with and without optional parts.
pub(super) fn joints() -> Vec<(String, Vec<u8>)> {
    let limits = [-0.5, 0.75, -1.0, 1.0, 0.0, 0.0];
    let mut joints = Vec::new();
    // Kind, 8 the bodies collide, 16 limits, 32 and 64 rotations, 128 motors, 256 strength.
    for flags in [
        0, 1, 2, 3, 8, 17, 18, 19, 32, 64, 96, 121, 4, 5, 6, 130, 256, 390, 494,
    ] {
        let mut bytes = v(flags);
        for (place, bit) in [(0, 32), (1, 64)] {
            bytes.extend([id(place + 3, 0), f(&[0.0, 0.5, -1.0])].concat());
            if flags & bit != 0 {
                bytes.extend(f(&TURNED));
            }
        }
        bytes.extend(match (flags & 7, flags & 16) {
            (1, 16) => f(&limits),
            (2 | 3, 16) => f(&limits[..2]),
            (4, _) => f(&[2.5]),
            (5, _) => f(&[1.0, 400.0, 20.0]),
            // Locks translations along x and y; limits along z and about x.
            (6, _) => [vec![0b11, 0b1100], f(&limits[..4])].concat(),
            _ => Vec::new(),
        });
        if flags & 128 != 0 {
            let motor = f(&[0.25, -1.0, 100.0, 10.0, 50.0]);
            bytes.extend([vec![0b1000], motor].concat());
        }
        if flags & 256 != 0 {
            bytes.extend(f(&[500.0, 25.0]));
        }
        let kinds = [
            "fixed",
            "spherical",
            "revolute",
            "prismatic",
            "rope",
            "spring",
            "generic",
        ];
        let kind = kinds[(flags & 7) as usize];
        joints.push((format!("{kind}, flags {flags}"), bytes));
    }
    joints
}

/// Revolute joints with limits and motors at their bounds and beyond: numbers that are not bounded one by one.
pub(super) fn hinges() -> Vec<(&'static str, Vec<u8>)> {
    let hinge = |flags, rest: Vec<u8>| {
        let sides = [3, 4].map(|index| [id(index, 0), f(&[0.0; 3])].concat());
        [v(flags), sides.concat(), rest].concat()
    };
    let limits = |least, most| hinge(2 | 16, f(&[least, most]));
    let motor = |axes, position, velocity| {
        let motor = f(&[position, velocity, 100.0, 10.0, 50.0]);
        hinge(2 | 128, [vec![axes], motor].concat())
    };
    let limited = |limits: [f32; 2], position| {
        let motor = f(&[position, 1.0, 100.0, 10.0, 50.0]);
        hinge(2 | 16 | 128, [f(&limits), vec![0b1000], motor].concat())
    };
    vec![
        ("limits of a whole turn", limits(-TAU, 0.0)),
        ("limits beyond half a turn", limits(-4.5, 1.5)),
        ("limits more than a turn apart", limits(-3.5, 3.5)),
        ("a limit beyond a turn", limits(0.5, 6.5)),
        ("limits in the wrong order", limits(0.75, 0.5)),
        ("a motor to half a turn", motor(0b1000, PI, 100.0)),
        ("a motor beyond half a turn", motor(0b1000, 3.25, 1.0)),
        (
            "a motor beyond half a turn with limits",
            limited([0.0, 4.75], 4.5),
        ),
        (
            "a motor beyond a turn with limits",
            limited([0.0, 4.75], 6.5),
        ),
        ("a motor that is too fast", motor(0b1000, 0.0, 100.5)),
        ("a motor of a locked axis", motor(0b1, 0.0, 1.0)),
    ]
}

/// A track encoded as a bit string.
pub(super) fn in_bits(predictor: Predictor, parent: Option<BodyId>) -> Vec<u8> {
    let moving = predictor != Predictor::Rest;
    let speed = |numbers: [i32; 3]| if moving { numbers } else { [0; 3] };
    let rotation = PackedRotation::from_parts(3, [1_000, -20_000, 0]).expect("a valid rotation");
    let anchor = QuantisedState {
        position: [70_000, -5, 0],
        rotation,
        linear: speed([12, -300, 0]),
        angular: speed([0, 1, -1]),
    };
    let mut bits = BitWriter::default();
    let payload = Keyframe {
        predictor,
        anchor: Anchor::Quantised(anchor),
        parent,
    };
    payload.encode(&mut bits);
    let bytes = bits.into_bytes();
    [v(bytes.len() as u64), bytes].concat()
}

/// Extensions with these ids; each value has as many bytes as its id has bits set.
pub(super) fn extensions(ids: &[u32]) -> Vec<u8> {
    let mut bytes = v(ids.len() as u64);
    for id in ids {
        let length = id.count_ones() as usize;
        bytes.extend(v(u64::from(*id)));
        bytes.extend([v(length as u64), vec![9; length]].concat());
    }
    bytes
}

/// Each choice of a stream with its name.
pub(super) fn choices() -> [(&'static str, Vec<u8>); 6] {
    [
        ("within 0.05 m", [vec![0], v(50_000)].concat()),
        ("full", vec![1]),
        ("changed", vec![4]),
        (
            "within 0.01 m and 0.002 rad",
            [vec![2], v(10_000), v(2_000)].concat(),
        ),
        (
            "within 0.05 m and 8000 bytes a second",
            [vec![3], v(8_000), v(2_000), vec![0], v(50_000)].concat(),
        ),
        (
            "within 0.01 m, 0.002 rad and the least bytes",
            [vec![3], v(256), v(1_150), vec![2], v(10_000), v(2_000)].concat(),
        ),
    ]
}

/// A list of cases under construction.
#[derive(Debug, Default)]
pub(super) struct CaseList(pub(super) Vec<MessageCase>);

impl CaseList {
    pub(super) fn add(&mut self, kind: u8, name: impl Into<String>, parts: &[&[u8]]) {
        let (name, body) = (name.into(), parts.concat());
        self.0.push(MessageCase {
            name,
            kind,
            body,
            rule: None,
        });
    }

    /// Adds messages of unknown types: of `critical`, the first free critical one, and of others.
    pub(super) fn add_unknown(&mut self, critical: u8) {
        for kind in [critical, 0x7f] {
            let name = format!("a critical type {kind} that is unknown");
            self.add(kind, name, &[&[1]]);
        }
        for kind in [0x85, 0x8a, 0xff] {
            let name = format!("an optional type {kind} that is unknown");
            self.add(kind, name, &[&[1, 2, 3]]);
        }
    }
}

/// Places of cells: within the limits, at them, and beyond.
pub(super) fn cell_places() -> Vec<(&'static str, Vec<u8>)> {
    let places = |numbers: [u64; 3]| numbers.map(v).concat();
    vec![
        ("a cell", places([3, 0, 600])),
        ("the last cells", places([200_002, 200_001, 0])),
        ("a place beyond the limits", places([0, 0, 200_003])),
        ("a place of 32 bits", places([0xffff_ffff, 0, 0])),
        ("a place of 33 bits", places([1 << 32, 0, 0])),
    ]
}

/// The name of a decoding error.
pub(super) fn word(why: Malformed) -> String {
    match why {
        Malformed::Motion(_) => "NotFinite".to_owned(),
        other => format!("{other:?}"),
    }
}
