//! Edges of the rules about scene configs, shapes and joints.

use core::f32::consts::{PI, TAU};

use super::message_case::{Edge, edge};
use super::pieces::{TURNED, UNIT, compound, f, heights, id, mesh, v};

/// The next f32 beyond the greatest extent.
const BEYOND: f32 = 10_000.0_f32.next_up();

/// A scene's configuration under construction.
#[derive(Clone, Copy)]
struct Config {
    rate: [u64; 2],
    substeps: u64,
    gravity: f32,
    stepping: u8,
    friction: f32,
    damping: f32,
    sleep: Option<f32>,
    publish_interval: u64,
    lookahead: u64,
}

impl Config {
    const fn at(ticks: u64, seconds: u64) -> Self {
        Self {
            rate: [ticks, seconds],
            substeps: 4,
            gravity: -9.81,
            stepping: 1,
            friction: 0.5,
            damping: 0.0,
            sleep: None,
            publish_interval: 1,
            lookahead: 0,
        }
    }

    fn bytes(self) -> Vec<u8> {
        let sleep = self
            .sleep
            .map(|speed| [vec![1], f(&[speed, 0.5, 2.0])].concat());
        [
            self.rate.map(v).concat(),
            v(self.substeps),
            f(&[0.0, self.gravity, 0.0]),
            vec![self.stepping],
            f(&[self.friction, 0.25, 1_000.0, self.damping, 0.0]),
            sleep.unwrap_or_else(|| vec![0]),
            v(self.publish_interval),
            v(self.lookahead),
        ]
        .concat()
    }
}

/// The greatest number of a config.
const MOST: u64 = u32::MAX as u64;

/// The limits of configs, and the order of their faults.
pub(super) fn configs() -> Vec<Edge> {
    let limits = [config_limits(), publish_intervals()].concat().into_iter();
    let limits = limits.map(|(name, config)| edge("7-1", name, config.bytes()));
    let orders = config_orders().into_iter();
    let orders = orders.map(|(name, config)| edge("4.5-3", name, config.bytes()));
    limits.chain(orders).collect()
}

/// Rates, substeps and lookaheads.
fn config_limits() -> Vec<(String, Config)> {
    let mut configs = Vec::new();
    for (ticks, seconds) in [
        (1_000, 1),
        (1_001, 1),
        (3_000, 3),
        (3_001, 3),
        (1, 1),
        (1, 2),
        (7, 8),
        (MOST, MOST),
        (MOST, MOST - 1),
        (MOST - 1, MOST),
        (MOST, 4_294_968),
        (MOST, 4_294_967),
    ] {
        let name = format!("{ticks} ticks in {seconds} seconds");
        configs.push((name, Config::at(ticks, seconds)));
    }
    let good = Config::at(60, 1);
    for substeps in [16, 17] {
        configs.push((format!("{substeps} substeps"), Config { substeps, ..good }));
    }
    for (lookahead, stepping) in [(6, 1), (7, 1), (1, 0), (7, 0)] {
        let name = format!("lookahead {lookahead}, stepping {stepping}");
        let config = Config {
            lookahead,
            stepping,
            ..good
        };
        configs.push((name, config));
    }
    configs
}

fn publish_intervals() -> Vec<(String, Config)> {
    let mut configs = Vec::new();
    for (ticks, seconds, publish_interval) in [
        (60, 1, 60),
        (60, 1, 61),
        (1, 1, 2),
        (3, 2, 1),
        (3, 2, 2),
        (61, 2, 30),
        (61, 2, 31),
        (MOST, MOST, 1),
        (MOST, MOST, MOST),
        (MOST, 1 << 31, 2),
    ] {
        let name = format!("every {publish_interval} ticks of {ticks} in {seconds} seconds");
        let config = Config {
            publish_interval,
            ..Config::at(ticks, seconds)
        };
        configs.push((name, config));
    }
    configs
}

/// Configs with two faults that follow each other.
fn config_orders() -> Vec<(&'static str, Config)> {
    let mut configs = Vec::new();
    let good = Config::at(60, 1);
    let mut faulty = Config {
        rate: [1, 2],
        substeps: 17,
        ..good
    };
    configs.push(("rate and substeps", faulty));
    faulty = Config {
        rate: [60, 1],
        gravity: f32::NAN,
        ..faulty
    };
    configs.push(("substeps and gravity", faulty));
    faulty = Config {
        substeps: 4,
        friction: -1.0,
        ..faulty
    };
    configs.push(("gravity and material", faulty));
    faulty = Config {
        gravity: 0.0,
        damping: f32::NAN,
        ..faulty
    };
    configs.push(("material and damping", faulty));
    faulty = Config {
        friction: 0.5,
        sleep: Some(-1.0),
        ..faulty
    };
    configs.push(("damping and sleep", faulty));
    faulty = Config {
        damping: 0.0,
        publish_interval: 61,
        ..faulty
    };
    configs.push(("sleep and publish interval", faulty));
    faulty = Config {
        sleep: None,
        lookahead: 7,
        ..faulty
    };
    configs.push(("publish interval and lookahead", faulty));
    faulty = Config {
        publish_interval: 1,
        stepping: 0,
        ..faulty
    };
    configs.push(("lookahead, in lockstep too", faulty));
    configs
}

/// 2^-10, about the least thickness of a hull.
const THIN: f32 = 1.0 / 1_024.0;

/// Hulls about the least thickness.
pub(super) fn hulls() -> Vec<Edge> {
    let all = [flat_hulls(), tied_hulls(), wide_hulls()]
        .concat()
        .into_iter();
    all.map(|(name, bytes)| edge("2.6-2", format!("a hull {name}"), bytes))
        .collect()
}

/// The name of a hull, and its bytes.
type Named = (&'static str, Vec<u8>);

fn hull(points: &[[f32; 3]]) -> Vec<u8> {
    [vec![4, points.len() as u8], f(&points.concat())].concat()
}

fn hull_of_bits(points: [[u32; 3]; 4]) -> Vec<u8> {
    hull(&points.map(|point| point.map(f32::from_bits)))
}

fn flat_hulls() -> Vec<Named> {
    let flat = |size: f32, height: f32| {
        let (x, y, z) = ([size, 0.0, 0.0], [0.0, size, 0.0], [0.0, 0.0, height]);
        hull(&[[0.0; 3], x, y, z])
    };
    let least = 0.001_f32;
    vec![
        ("as thick as the least", flat(0.5, least)),
        ("less thick than the least", flat(0.5, least.next_down())),
        // Thicker than 0.001, but not than its f32.
        (
            "less thick than the f32 of the least",
            hull_of_bits([
                [0; 3],
                [0x3f40_0000, 0, 0],
                [0, 0x3ee5_da4e, 0x3e86_4759],
                [0, 0, 0x3a97_cca8],
            ]),
        ),
        ("as thick as its radius allows", flat(8_000.0, 8.000_001)),
        // A thousandth of its radius, but less than the f32 of a thousandth.
        ("less thick than its radius allows", flat(8_000.0, 8.0)),
        ("of one metre, too flat for its radius", flat(10.0, 0.005)),
        (
            "whose radius counts from the body's origin",
            hull(&[
                [5_000.0, 0.0, 0.0],
                [5_001.0, 0.0, 0.0],
                [5_000.0, 1.0, 0.0],
                [5_000.0, 0.0, 1.0],
            ]),
        ),
        (
            "on the other side of its plane",
            hull(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
        ),
        (
            "on a line",
            hull(&[
                [0.0; 3],
                [1.0, 1.0, 1.0],
                [2.0, 2.0, 2.0],
                [-1.0, -1.0, -1.0],
            ]),
        ),
        ("of one point, four times", hull(&[[1.0, 2.0, 3.0]; 4])),
    ]
}

/// Hulls whose points are equally far, or whose thickness is another in single precision.
fn tied_hulls() -> Vec<Named> {
    vec![
        (
            "thick enough, by the first of two farthest points",
            hull(&[
                [0.0; 3],
                [0.25, 0.375, 1.5 * THIN],
                [0.5, 0.125, 0.0],
                [-0.25, 0.0, 0.0],
                [0.5, -0.125, 0.0],
            ]),
        ),
        (
            "too flat, by the first of two farthest points",
            hull(&[
                [0.0; 3],
                [0.25, 0.375, 3.0 * THIN],
                [-0.5, 0.125, 0.5 * THIN],
                [0.25, 0.0, THIN],
                [0.5, 0.125, 0.5 * THIN],
            ]),
        ),
        (
            "too flat, by the first of two points farthest from a line",
            hull(&[
                [0.0; 3],
                [0.25, 0.125, 2.0 * THIN],
                [0.125, -0.25, 0.25 * THIN],
                [0.125, 0.25, 0.25 * THIN],
                [0.5, 0.0, 2.0 * THIN],
            ]),
        ),
        // In single precision each is on the other side.
        (
            "too flat in doubles",
            hull_of_bits([
                [0x3e00_0000, 0x3dcc_cccd, 0],
                [0x3f60_0000, 0x3dcc_cccd, 0x3e98_f40e],
                [0x3e00_0000, 0x3ee7_5b9c, 0x3e2e_62f0],
                [0x3e00_0000, 0x3dcc_cccd, 0x3a9a_b143],
            ]),
        ),
        (
            "thick enough in doubles",
            hull_of_bits([
                [0x3e00_0000, 0x3dcc_cccd, 0],
                [0x3f60_0000, 0x3dcc_cccd, 0x3dac_31d6],
                [0x3e00_0000, 0x3ee1_5e01, 0x3ea3_7079],
                [0x3e00_0000, 0x3dcc_cccd, 0x3ab4_5868],
            ]),
        ),
    ]
}

fn wide_hulls() -> Vec<Named> {
    vec![
        (
            "with a coordinate out of range, then NaN",
            hull(&[
                [0.0; 3],
                [1.0, 2e4, f32::NAN],
                [0.0, 1.0, 0.0],
                [0.0, 0.0, 1.0],
            ]),
        ),
        (
            "of the greatest coordinates",
            hull(&[[0.0; 3], [1e4, 0.0, 0.0], [0.0, -1e4, 0.0], [0.0, 0.0, 1e4]]),
        ),
        (
            "with a coordinate beyond the greatest",
            hull(&[
                [0.0; 3],
                [1e4, 0.0, 0.0],
                [0.0, -BEYOND, 0.0],
                [0.0, 0.0, 1e4],
            ]),
        ),
    ]
}

/// Other shapes at the edge of a rule, and the order of their faults.
pub(super) fn shape_edges() -> Vec<Edge> {
    let mut edges = [height_edges(), mesh_edges(), shape_orders(), compounds()].concat();
    let (long, short) = (1.001_f32, 0.999_f32);
    for (word, length) in [
        ("barely not too long", long.next_down()),
        ("barely too long", long),
        ("barely not too short", short),
        ("barely too short", short.next_down()),
    ] {
        let normal = [vec![10], f(&[0.0, length, 0.0])].concat();
        edges.push(edge(
            "2.6-4",
            format!("a half-space of a normal that is {word}"),
            normal,
        ));
    }
    for (name, bits) in UNIT {
        let [x, y, z, w] = bits.map(f32::from_bits);
        let ball = [vec![0], f(&[0.5])].concat();
        let turned = [vec![7, 1], f(&[0.0; 3]), f(&[x, y, z, w]), ball].concat();
        edges.push(edge("4.5-2", format!("a part with {name}"), turned));
    }
    edges
}

/// More than any count.
const FAR: u64 = 1 << 63;

/// Three corners.
const CORNERS: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

fn height_edges() -> Vec<Edge> {
    // Three times this is half a unit in the last place above the most: the f32 of the product is the most.
    let third = f32::from_bits(0x4550_5556);
    let posts =
        |counts: [u64; 2]| [vec![5], counts.map(v).concat(), f(&[1.0; 2]), vec![0]].concat();
    vec![
        edge(
            "2.6-7",
            "heights whose length is the most in f32",
            heights([4, 2], [third, 1.0]),
        ),
        edge(
            "2.6-7",
            "heights whose width is the most in f32",
            heights([2, 4], [1.0, third]),
        ),
        edge(
            "2.6-7",
            "heights that are barely too long",
            heights([4, 2], [third.next_up(), 1.0]),
        ),
        edge(
            "2.6-7",
            "heights that are barely too wide",
            heights([2, 4], [1.0, third.next_up()]),
        ),
        edge(
            "2.6-7",
            "heights of 2^32 posts, and none",
            posts([65_536, 65_536]),
        ),
        edge(
            "2.6-7",
            "heights of 2^36 posts, and none",
            posts([262_144, 262_144]),
        ),
        edge("2.6-7", "heights of 2^63 rows", posts([FAR, 2])),
        edge("2.6-7", "heights of 2^64 - 1 columns", posts([2, u64::MAX])),
        edge(
            "2.6-7",
            "heights of one beyond the greatest",
            [posts([2, 2]), f(&[1e4, -1e4, BEYOND, 0.0])].concat(),
        ),
    ]
}

fn mesh_edges() -> Vec<Edge> {
    let counted = |points: u64, triangles: u64, places: [u64; 3]| {
        let counts = [v(points), v(triangles), vec![0]].concat();
        [vec![6], counts, f(&CORNERS), places.map(v).concat()].concat()
    };
    vec![
        edge("2.6-8", "a mesh of 2^63 points", counted(FAR, 1, [0, 1, 2])),
        edge(
            "2.6-8",
            "a mesh of 2^64 - 1 triangles",
            counted(3, u64::MAX, [0, 1, 2]),
        ),
        edge(
            "2.6-8",
            "a mesh with a place of 2^63",
            counted(3, 1, [0, 1, FAR]),
        ),
        edge(
            "2.6-8",
            "a mesh with the place behind the last",
            counted(3, 1, [0, 1, 3]),
        ),
        edge(
            "2.6-8",
            "a mesh of one point thrice",
            counted(3, 1, [2, 2, 2]),
        ),
        edge(
            "2.6-8",
            "a mesh of a coordinate beyond the greatest",
            mesh(
                &[1e4, 0.0, 0.0, 0.0, -BEYOND, 0.0, 0.0, 0.0, 1.0],
                &[0, 1, 2],
            ),
        ),
    ]
}

/// Shapes with two faults that follow each other.
fn shape_orders() -> Vec<Edge> {
    let nan = f32::NAN;
    vec![
        edge(
            "2.6-11",
            "heights of row and column spacings at fault",
            heights([2, 2], [2e4, nan]),
        ),
        edge(
            "2.6-11",
            "a column spacing at fault, and a height of NaN",
            [vec![5, 2, 2], f(&[1.0, 0.0]), vec![0], f(&[nan; 4])].concat(),
        ),
        edge(
            "2.6-11",
            "a capsule out of range, with a radius of NaN",
            [vec![2], f(&[0.0, nan])].concat(),
        ),
        edge(
            "2.6-11",
            "a cone of NaN, with a radius out of range",
            [vec![9], f(&[nan, 0.0])].concat(),
        ),
        edge(
            "2.6-11",
            "a rounded cuboid out of range, with a radius of NaN",
            [vec![8], f(&[1.0, 2e4, 1.0, nan])].concat(),
        ),
        edge(
            "2.6-11",
            "a mesh of no triangles, with a coordinate of NaN",
            mesh(&[nan, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0], &[]),
        ),
        edge(
            "2.6-11",
            "a mesh of two points and no triangles",
            mesh(&CORNERS[..6], &[]),
        ),
    ]
}

/// Compounds with several faults, in the order of parts.
fn compounds() -> Vec<Edge> {
    let ball = |radius: f32| [vec![0], f(&[radius])].concat();
    let part = |position: f32, rotation: [f32; 4], shape: Vec<u8>| {
        [f(&[position, 0.0, 0.0]), f(&rotation), shape].concat()
    };
    let all = |parts: &[Vec<u8>]| [vec![7, parts.len() as u8], parts.concat()].concat();
    let none = [0.0; 4];
    vec![
        edge(
            "2.6-11",
            "a part with position and rotation at fault",
            all(&[part(2e4, none, ball(0.5))]),
        ),
        edge(
            "2.6-11",
            "a part with rotation and shape at fault",
            all(&[part(0.0, none, ball(0.0))]),
        ),
        edge(
            "2.6-11",
            "a part of a ball out of range, and one at NaN",
            all(&[
                part(0.0, TURNED, ball(2e4)),
                part(f32::NAN, TURNED, ball(0.5)),
            ]),
        ),
        edge(
            "2.6-11",
            "a part of no rotation, and one out of range",
            all(&[part(0.0, none, ball(0.5)), part(2e4, TURNED, ball(0.5))]),
        ),
        edge(
            "2.6-11",
            "a part that is a flat hull, and one out of range",
            all(&[
                part(0.0, TURNED, [vec![4, 4], f(&[0.0; 12])].concat()),
                part(2e4, TURNED, ball(0.5)),
            ]),
        ),
        edge(
            "2.6-9",
            "a compound of a compound of nothing",
            compound(&[vec![7, 0]]),
        ),
    ]
}

/// Joints at the edge of a rule, and the order of their faults.
pub(super) fn joint_edges() -> Vec<Edge> {
    let mut edges = Vec::new();
    // Limits that may not be there, and nothing in their place.
    for (kind, word, rest) in [
        (0, "fixed", vec![]),
        (4, "rope", f(&[2.5])),
        (5, "spring", f(&[1.0, 400.0, 20.0])),
        (6, "generic", vec![0b11, 0]),
    ] {
        let name = format!("a {word} joint with bit 4");
        edges.push(edge("2.6-25", name, joint(kind | 16, &rest)));
    }
    let motor = |axis: u8| [vec![1 << axis], f(&[0.25, -1.0, 100.0, 10.0, 50.0])].concat();
    for (kind, word, axis, rest) in [
        (0, "fixed", 3, vec![]),
        (1, "spherical", 0, vec![]),
        (2, "revolute", 4, vec![]),
        (3, "prismatic", 3, vec![]),
        (4, "rope", 0, f(&[2.5])),
        (5, "spring", 0, f(&[1.0, 400.0, 20.0])),
        (6, "generic", 1, vec![0b10, 0]),
    ] {
        let name = format!("a {word} joint with a motor of axis {axis}");
        let rest = [rest, motor(axis)].concat();
        edges.push(edge("2.6-25", name, joint(kind | 128, &rest)));
    }
    [edges, joint_limits(), frame_orders(), joint_orders()].concat()
}

/// Limits of axes of generic joints.
fn joint_limits() -> Vec<Edge> {
    let mut edges = Vec::new();
    let generic = |locked: u8, limited: u8, limits: &[f32]| {
        joint(6, &[vec![locked, limited], f(limits)].concat())
    };
    for (name, locked, limited, limits) in [
        ("limits of a locked translation", 0b10, 0b10, [-0.5, 0.5]),
        (
            "limits of a locked rotation",
            0b1_0000,
            0b1_0000,
            [-0.5, 0.5],
        ),
        (
            "limits of a free axis beside a locked one",
            0b10,
            0b100,
            [-0.5, 0.5],
        ),
        (
            "limits of a locked axis that are NaN",
            0b10,
            0b10,
            [f32::NAN, 0.5],
        ),
        ("the greatest limits of a translation", 0, 0b1, [-1e4, 1e4]),
        (
            "limits of a translation beyond the greatest",
            0,
            0b1,
            [-1e4, BEYOND],
        ),
        (
            "limits of a rotation of a whole turn",
            0,
            0b100_000,
            [-PI, PI],
        ),
        (
            "limits of a rotation above a whole turn",
            0,
            0b100_000,
            [-PI, PI.next_up()],
        ),
        ("limits about a whole turn", 0, 0b1000, [0.0, TAU]),
        (
            "limits beyond a whole turn",
            0,
            0b1000,
            [0.5, TAU.next_up()],
        ),
        ("equal limits", 0, 0b1, [0.5, 0.5]),
        (
            "limits of no least and a most out of range",
            0,
            0b1,
            [f32::NAN, 2e4],
        ),
        (
            "limits of a least out of range and no most",
            0,
            0b1,
            [-2e4, f32::NAN],
        ),
    ] {
        edges.push(edge("2.6-25", name, generic(locked, limited, &limits)));
    }
    edges
}

/// A joint between bodies 3 and 4 at their centres of mass.
fn joint(flags: u64, rest: &[u8]) -> Vec<u8> {
    let sides = [3, 4].map(|index| [id(index, 0), f(&[0.0; 3])].concat());
    [v(flags), sides.concat(), rest.to_vec()].concat()
}

/// Joints with two faults that follow each other in the order of 4.5-3, one of them of a frame.
fn frame_orders() -> Vec<Edge> {
    let (nan, far, none) = (f32::NAN, 2e4, [0.0; 4]);
    let sides = |anchors: [f32; 2], rotations: [[f32; 4]; 2]| {
        let side = |place: usize| {
            let anchor = f(&[anchors[place], 0.0, 0.0]);
            [id(place as u64 + 3, 0), anchor, f(&rotations[place])].concat()
        };
        [side(0), side(1)].concat()
    };
    let both = |anchors, rotations| [v(96), sides(anchors, rotations)].concat();
    let rope = |anchors, rotations| [v(100), sides(anchors, rotations), f(&[nan])].concat();
    vec![
        edge(
            "4.5-3",
            "anchors, out of range and NaN",
            both([far, nan], [TURNED; 2]),
        ),
        edge(
            "4.5-3",
            "anchors, NaN and out of range",
            both([nan, far], [TURNED; 2]),
        ),
        edge(
            "4.5-3",
            "a first anchor and a first rotation",
            both([far, 0.0], [none, TURNED]),
        ),
        edge(
            "4.5-3",
            "a first rotation and a second anchor",
            both([0.0, far], [none, TURNED]),
        ),
        edge(
            "4.5-3",
            "a second anchor and a second rotation",
            both([0.0, far], [TURNED, none]),
        ),
        edge(
            "4.5-3",
            "a second rotation and a length",
            rope([0.0; 2], [TURNED, none]),
        ),
    ]
}

/// Joints with two faults behind their frames.
fn joint_orders() -> Vec<Edge> {
    let nan = f32::NAN;
    let motor = f(&[4.0, -1.0, 100.0, 10.0, 50.0]);
    let slow = f(&[0.0, 200.0, nan, 10.0, 50.0]);
    let hinge = |flags: u64, rest: &[Vec<u8>]| joint(2 | flags, &rest.concat());
    vec![
        edge("4.5-3", "a length, and a strength of NaN", {
            joint(4 | 256, &f(&[0.0, nan, 1.0]))
        }),
        edge(
            "4.5-3",
            "a spring, and a strength of NaN",
            joint(5 | 256, &f(&[-1.0, 400.0, 20.0, nan, 1.0])),
        ),
        edge(
            "4.5-3",
            "a spring's stiffness out of range, and a damping of NaN",
            joint(5, &f(&[1.0, 2e6, nan])),
        ),
        edge(
            "4.5-3",
            "limits, and a motor of NaN",
            hinge(16 | 128, &[f(&[0.5, 0.25]), vec![0b1000], f(&[nan; 5])]),
        ),
        edge(
            "4.5-3",
            "a motor, and a strength of NaN",
            hinge(128 | 256, &[vec![0b1000], motor, f(&[nan, 1.0])]),
        ),
        edge(
            "4.5-3",
            "a motor too fast, with a stiffness of NaN",
            hinge(128, &[vec![0b1000], slow]),
        ),
        edge(
            "4.5-3",
            "a strength out of range, with a torque of NaN",
            hinge(256, &[f(&[-1.0, nan])]),
        ),
        edge(
            "4.5-3",
            "limits about x out of range, and about y NaN",
            joint(1 | 16, &f(&[0.5, 7.0, nan, 0.5, 0.0, 0.5])),
        ),
        edge(
            "4.5-3",
            "limits about x NaN, and about y out of range",
            joint(1 | 16, &f(&[0.5, nan, 7.0, 0.5, 0.0, 0.5])),
        ),
        edge(
            "4.5-3",
            "limits of axis 2 of a generic joint, and a motor of a locked axis 0",
            joint(
                6 | 128,
                &[vec![1, 4], f(&[0.5, 0.25]), vec![1], f(&[0.0; 5])].concat(),
            ),
        ),
    ]
}
