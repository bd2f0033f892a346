//! Cases of grids: steps, quantised motions, tracks.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    Anchor, Conditions, Grid, LengthBound, Metres, Motion, Pose, Predictor, QuantisedState,
    Radians, Tick, Tolerance, ToleranceScale, Track, TurnBound, Twist,
};

use super::flight::{GRAVITIES, accelerations, gravity, tables, with_predictor};
use super::rng::{VectorRng, motion, thirteen};
use crate::document::CaseJson;

/// The formulas of RECKONING 4.5, repeated because shapes belong to another crate.
fn radius(shape: &str, e: &[f64], rows: usize) -> f64 {
    let length = |point: &[f64]| {
        libm::sqrt((point[0] * point[0] + point[1] * point[1]) + point[2] * point[2])
    };
    match shape {
        "ball" => e[0],
        "cuboid" => length(e),
        "capsule" => e[0] + e[1],
        "cylinder" => libm::sqrt(e[0] * e[0] + e[1] * e[1]),
        "rounded cuboid" => length(e) + e[3],
        "cone" => libm::sqrt((e[0] * 0.5) * (e[0] * 0.5) + e[1] * e[1]).max(e[0] * 1.5),
        "half-space" => 10_000.0,
        "hull" | "mesh" => e.chunks(3).map(length).fold(0.0, f64::max),
        "heights" => {
            let columns = (e.len() - 2) / rows;
            let post = |(place, y): (usize, &f64)| {
                let (row, column) = ((place / columns) as f64, (place % columns) as f64);
                length(&[row * e[0], *y, column * e[1]])
            };
            e[2..].iter().enumerate().map(post).fold(0.0, f64::max)
        }
        "compound" => {
            let reach = |ball: &[f64]| length(ball) + ball[3];
            let least = f64::from(0.001_f32);
            e.chunks(4).map(reach).fold(least, f64::max)
        }
        _ => unreachable!("no such shape: {shape}"),
    }
}

/// Bounding radii of all shapes. Extents are in the order of PROTOCOL 2.6; points and heights follow one another; a
/// compound is one of balls, each with its position and radius.
pub(super) fn radii() -> Vec<CaseJson> {
    let case = |shape: &str, rows: i32, extents: &[f32]| {
        let e: Vec<f64> = extents.iter().map(|part| f64::from(*part)).collect();
        let radius = radius(shape, &e, rows as usize);
        let named = CaseJson::new().text("shape", shape);
        let counted = match rows {
            0 => named,
            rows => named.integer("rows", rows),
        };
        counted
            .singles("extents", extents)
            .doubles("radius", &[radius])
    };
    let points = [
        0.5, 0.1, 0.25, -0.5, 0.25, 0.3, 0.2, 0.75, -0.5, 0.1, -0.5, -1.1,
    ];
    vec![
        case("ball", 0, &[0.3]),
        case("ball", 0, &[50.0]),
        case("cuboid", 0, &[0.5, 0.5, 0.5]),
        case("cuboid", 0, &[0.1, 2.0, 0.7]),
        case("cuboid", 0, &[100.0, 0.01, 33.3]),
        case("capsule", 0, &[0.6, 0.3]),
        case("capsule", 0, &[1.1, 0.1]),
        case("cylinder", 0, &[0.6, 0.3]),
        case("cylinder", 0, &[0.01, 7.7]),
        case("rounded cuboid", 0, &[0.1, 2.0, 0.7, 0.05]),
        case("rounded cuboid", 0, &[0.3, 0.3, 0.3, 1.1]),
        // The tip of the first cone is farther than the rim of its base, that of the second one is not.
        case("cone", 0, &[0.9, 0.4]),
        case("cone", 0, &[0.4, 0.9]),
        case("half-space", 0, &[0.0, 1.0, 0.0]),
        case("hull", 0, &points),
        case("mesh", 0, &points),
        case("heights", 2, &[1.5, 0.7, 0.1, 0.2, -0.6, 0.3, 0.1, 0.9]),
        case("heights", 3, &[0.3, 1.7, 0.1, 0.2, -3.6, 0.3, 0.1, 0.9]),
        case("compound", 0, &[]),
        case("compound", 0, &[0.1, 0.2, 0.3, 0.4, -0.9, 0.1, 0.1, 0.1]),
    ]
}

/// Tolerance in micrometres and bounding radius in metres.
pub(super) const GRIDS: [(u32, f64); 12] = [
    (5_000, 0.5),
    (20_000, 0.866_025_403_784_438_6),
    (50_000, 0.1),
    (200_000, 1.7),
    (1_000, 100.0),
    (1_000, 0.001),
    (10_000_000, 0.01),
    (10_000_000, 1_000.0),
    (33_333, 0.333),
    (123_457, 12.5),
    (50_000, 0.075),
    (50_000, 0.009_375),
];

pub(super) fn grid(index: usize) -> Grid {
    let (micrometres, radius) = GRIDS[index];
    let tolerance = Tolerance::from_micrometres(micrometres).expect("the cases are within bounds");
    Grid::new(tolerance, Metres::new(radius))
}

/// Bounds of position and turn apart: micrometres, microradians, and a radius that must not matter.
const PARTS: [(u32, u32, f64); 6] = [
    (2_000, 8_727, 0.35),
    (10_000, 2_000, 1.9),
    (1_000, 100, 0.001),
    (1_000, 3_141_593, 100.0),
    (10_000_000, 285_714, 1.0),
    (33_333, 666_667, 12.5),
];

/// Integers of a parts tolerance and a tolerance scale.
const CLASSES: [(u32, u32, i8); 10] = [
    (50_000, 20_000, 0),
    (50_000, 20_000, -1),
    (50_000, 20_000, 1),
    (33_333, 777, -1),
    (33_333, 777, -2),
    (7_999, 799, -3),
    (8_001, 801, -3),
    (1_000, 100, -1),
    (2_000_000, 1_000_000, 3),
    (1_250_000, 392_699, 3),
];

pub(super) fn tolerance_scales() -> Vec<CaseJson> {
    let case = |&(micrometres, microradians, exponent): &(u32, u32, i8)| {
        let tolerance = Tolerance::Parts {
            position: LengthBound::from_micrometres(micrometres).expect("within bounds"),
            turn: TurnBound::from_microradians(microradians).expect("within bounds"),
        };
        let tolerance_scale = ToleranceScale::new(exponent).expect("within bounds");
        let Tolerance::Parts { position, turn } = tolerance.scaled(tolerance_scale) else {
            unreachable!("a scale does not change the kind of a tolerance");
        };
        CaseJson::new()
            .integer("micrometres", micrometres)
            .integer("microradians", microradians)
            .integer("tolerance_scale", exponent)
            .integer("position", position.micrometres())
            .integer("turn", turn.microradians())
    };
    CLASSES.iter().map(case).collect()
}

pub(super) fn grids() -> Vec<CaseJson> {
    let steps = |grid: Grid| {
        let (position, fine) = (grid.position(), grid.fine());
        [position, fine, grid.turn(), grid.linear(), grid.angular()]
    };
    let surface = |(index, &(micrometres, radius)): (usize, &(u32, f64))| {
        CaseJson::new()
            .integer("micrometres", micrometres)
            .doubles("radius", &[radius])
            .doubles("steps", &steps(grid(index)))
    };
    let parts = |&(micrometres, microradians, radius): &(u32, u32, f64)| {
        let millionths = |count: u32| f64::from(count) / 1e6;
        let (position, turn) = (millionths(micrometres), millionths(microradians));
        let tolerance = Tolerance::parts(Metres::new(position), Radians::new(turn));
        let tolerance = tolerance.expect("the cases are within bounds");
        CaseJson::new()
            .integer("micrometres", micrometres)
            .integer("microradians", microradians)
            .doubles("radius", &[radius])
            .doubles("steps", &steps(Grid::new(tolerance, Metres::new(radius))))
    };
    let surfaces = GRIDS.iter().enumerate().map(surface);
    surfaces.chain(PARTS.iter().map(parts)).collect()
}

/// The integers of a quantised motion, and the motion that they mean.
pub(super) fn quantised(case: CaseJson, quantised: &QuantisedState, grid: &Grid) -> CaseJson {
    let (largest, others) = quantised.rotation.parts();
    case.integers("position", &quantised.position)
        .integer("largest", largest)
        .integers("others", &others)
        .integers("linear", &quantised.linear)
        .integers("angular", &quantised.angular)
        .doubles("means", &thirteen(&quantised.motion(grid)))
}

pub(super) fn quantisations(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = Vec::new();
    let mut add = |index: usize, motion: &Motion| {
        let case = CaseJson::new()
            .integer("grid", index as i64)
            .doubles("motion", &thirteen(motion));
        let grid = grid(index);
        cases.push(quantised(case, &QuantisedState::of(motion, &grid), &grid));
    };
    for index in 0..GRIDS.len() {
        let grid = grid(index);
        add(index, &rng.motion());
        add(index, &rng.motion());
        // Halves on both sides of zero.
        let halves = DVec3::new(0.5, -0.5, 2.5);
        let at_halves = Pose {
            position: halves * grid.fine(),
            rotation: DQuat::IDENTITY,
        };
        let by_halves = Twist {
            linear: halves * -grid.linear(),
            angular: halves * grid.angular(),
        };
        add(index, &motion(at_halves, by_halves));
    }
    for far in [1.0e9, 1.0e30, f64::MAX] {
        let far = DVec3::new(far, -far, far);
        let pose = Pose {
            position: far,
            rotation: rng.rotation(),
        };
        let twist = Twist {
            linear: far,
            angular: -far,
        };
        add(0, &motion(pose, twist));
        add(6, &motion(pose, twist));
    }
    cases
}

/// Tracks with a quantised anchor over many ticks, some before their origin.
pub(super) fn tracks(rng: &mut VectorRng) -> Vec<CaseJson> {
    let tables = tables();
    let origin = 1_u64 << 40;
    let mut cases = Vec::new();
    for index in 0..24 {
        let (grid_index, table) = (index % GRIDS.len(), index % 7);
        let pull = index % 6;
        let grid = grid(grid_index);
        let anchor = QuantisedState::of(&rng.motion(), &grid);
        let predictors = [Predictor::Ballistic, Predictor::Uniform, Predictor::Rest];
        let predictor = match index % 4 {
            3 => Predictor::Accelerated(accelerations()[index % 5]),
            _ => predictors[index % 3],
        };
        let track = Track {
            origin: Tick::new(origin),
            predictor,
            anchor: Anchor::Quantised(anchor),
            parent: None,
        };
        let tick = origin - 5 + (index as u64 * index as u64 * 7) % 1_500;
        let end = track.at(
            Tick::new(tick),
            &grid,
            &Conditions {
                gravity: gravity(GRAVITIES[pull]),
                flow: &tables[table],
                inertia: None,
            },
        );
        let case = with_predictor(CaseJson::new(), predictor)
            .integer("integrator", table as i64)
            .integer("grid", grid_index as i64)
            .integer("gravity", pull as i64)
            .integer("origin", origin as i64)
            .integer("tick", tick as i64);
        let case = quantised(case, &anchor, &grid);
        cases.push(case.doubles("end", &thirteen(&end)));
    }
    cases
}
