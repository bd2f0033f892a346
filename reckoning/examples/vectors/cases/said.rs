//! Cases of what is said on grids: snapped motions, residuals, tracks.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    Anchor, Grid, Metres, Motion, POSITION_LIMIT, Pose, Predictor, Residual, Snapped, TURN_LIMIT,
    Tick, Tolerance, Track, Twist, VELOCITY_LIMIT,
};

use super::chance::{Chance, motion, thirteen};
use super::flight::{GRAVITIES, gravity, law_name, tables};
use crate::document::Case;

/// Ball, cuboid, capsule, cylinder: formulas of RECKONING 4.5, repeated here because shapes live a floor above.
pub(super) fn radii() -> Vec<Case> {
    let case = |shape: &str, extents: &[f32]| {
        let e: Vec<f64> = extents.iter().map(|part| f64::from(*part)).collect();
        let radius = match shape {
            "ball" => e[0],
            "cuboid" => libm::sqrt((e[0] * e[0] + e[1] * e[1]) + e[2] * e[2]),
            "capsule" => e[0] + e[1],
            _ => libm::sqrt(e[0] * e[0] + e[1] * e[1]),
        };
        Case::new()
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

pub(super) fn grids() -> Vec<Case> {
    let case = |(index, &(micrometres, radius)): (usize, &(u32, f64))| {
        let grid = grid(index);
        let steps = [grid.position(), grid.turn(), grid.linear(), grid.angular()];
        Case::new()
            .integer("micrometres", micrometres)
            .doubles("radius", &[radius])
            .doubles("steps", &steps)
    };
    GRIDS.iter().enumerate().map(case).collect()
}

/// The integers of a snapped motion, and the motion that they mean.
pub(super) fn snapped(case: Case, snapped: &Snapped, grid: &Grid) -> Case {
    let (largest, others) = snapped.rotation.parts();
    case.integers("position", &snapped.position)
        .integer("largest", largest)
        .integers("others", &others)
        .integers("linear", &snapped.linear)
        .integers("angular", &snapped.angular)
        .doubles("means", &thirteen(&snapped.motion(grid)))
}

pub(super) fn snappings(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    let mut add = |index: usize, motion: &Motion| {
        let case = Case::new()
            .integer("grid", index as i64)
            .doubles("motion", &thirteen(motion));
        let grid = grid(index);
        cases.push(snapped(case, &Snapped::of(motion, &grid), &grid));
    };
    for index in 0..GRIDS.len() {
        let grid = grid(index);
        add(index, &chance.motion());
        add(index, &chance.motion());
        // Halves on both sides of zero.
        let halves = DVec3::new(0.5, -0.5, 2.5);
        let at_halves = Pose {
            position: halves * grid.position(),
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
            rotation: chance.rotation(),
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

pub(super) fn residuals(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    let mut add = |index: usize, predicted: &Motion, residual: &Residual| {
        let case = Case::new()
            .integer("grid", index as i64)
            .doubles("predicted", &thirteen(predicted))
            .integers("position_residual", &residual.position)
            .integers("turn_residual", &residual.turn)
            .integers("linear_residual", &residual.linear)
            .integers("angular_residual", &residual.angular);
        let grid = grid(index);
        cases.push(snapped(case, &residual.onto(predicted, &grid), &grid));
    };
    for index in 0..GRIDS.len() {
        for size in [3, 40, TURN_LIMIT] {
            let mut steps = |limit| core::array::from_fn(|_| chance.steps(limit));
            let residual = Residual {
                position: steps(size * 4),
                turn: steps(size),
                linear: steps(size),
                angular: steps(size),
            };
            add(index, &chance.motion(), &residual);
        }
    }
    // No residual; no turn; the limits, which saturate.
    add(2, &chance.motion(), &Residual::default());
    let sideways = Residual {
        position: [1, -1, 0],
        ..Residual::default()
    };
    add(3, &chance.motion(), &sideways);
    for sign in [1, -1] {
        let most = Residual {
            position: [sign * POSITION_LIMIT; 3],
            turn: [sign * TURN_LIMIT; 3],
            linear: [sign * VELOCITY_LIMIT; 3],
            angular: [sign * VELOCITY_LIMIT; 3],
        };
        add(0, &chance.motion(), &most);
        add(6, &chance.motion(), &most);
    }
    cases
}

/// Snapped anchors followed over ticks, before their origin too.
pub(super) fn tracks(chance: &mut Chance) -> Vec<Case> {
    let tables = tables();
    let origin = 1_u64 << 40;
    let mut cases = Vec::new();
    for index in 0..24 {
        let (grid_index, table) = (index % GRIDS.len(), index % 7);
        let pull = index % 6;
        let grid = grid(grid_index);
        let anchor = Snapped::of(&chance.motion(), &grid);
        let law = [Predictor::Ballistic, Predictor::Uniform, Predictor::Rest][index % 3];
        let track = Track {
            origin: Tick::new(origin),
            predictor: law,
            anchor: Anchor::Snapped(anchor),
        };
        let tick = origin - 5 + (index as u64 * index as u64 * 7) % 1_500;
        let end = track.at(
            Tick::new(tick),
            &grid,
            gravity(GRAVITIES[pull]),
            &tables[table],
        );
        let case = Case::new()
            .text("law", law_name(law))
            .integer("integrator", table as i64)
            .integer("grid", grid_index as i64)
            .integer("gravity", pull as i64)
            .integer("origin", origin as i64)
            .integer("tick", tick as i64);
        let case = snapped(case, &anchor, &grid);
        cases.push(case.doubles("end", &thirteen(&end)));
    }
    cases
}
