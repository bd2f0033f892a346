//! Cases of grids: steps, quantised motions, tracks.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    Anchor, Conditions, Grid, LengthBound, Metres, Motion, Pose, Predictor, QuantisedState,
    Radians, Tick, Tolerance, ToleranceScale, Track, TurnBound, Twist,
};

use super::flight::{GRAVITIES, accelerations, gravity, tables, with_predictor};
use super::rng::{VectorRng, motion, thirteen};
use crate::document::CaseJson;

/// Ball, cuboid, capsule, cylinder: the formulas of RECKONING 4.5, repeated because shapes belong to another crate.
pub(super) fn radii() -> Vec<CaseJson> {
    let case = |shape: &str, extents: &[f32]| {
        let e: Vec<f64> = extents.iter().map(|part| f64::from(*part)).collect();
        let radius = match shape {
            "ball" => e[0],
            "cuboid" => libm::sqrt((e[0] * e[0] + e[1] * e[1]) + e[2] * e[2]),
            "capsule" => e[0] + e[1],
            _ => libm::sqrt(e[0] * e[0] + e[1] * e[1]),
        };
        CaseJson::new()
            .text("shape", shape)
            .singles("extents", extents)
            .doubles("radius", &[radius])
    };
    vec![
        case("ball", &[0.3]),
        case("ball", &[50.0]),
        case("cuboid", &[0.5, 0.5, 0.5]),
        case("cuboid", &[0.1, 2.0, 0.7]),
        case("cuboid", &[100.0, 0.01, 33.3]),
        case("capsule", &[0.6, 0.3]),
        case("capsule", &[1.1, 0.1]),
        case("cylinder", &[0.6, 0.3]),
        case("cylinder", &[0.01, 7.7]),
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
