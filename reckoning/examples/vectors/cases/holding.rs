//! Cases of what is held: seen from its carrier, said on a grid, carried on.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{Motion, Pose, Snapped, Twist, carried, seen_from};

use super::chance::{Chance, motion, thirteen};
use super::said::{GRIDS, grid, snapped};
use crate::document::Case;

/// Carriers with what they hold near them, then edges: no turn, signed zeros, half turns, what no grid reaches.
pub(super) fn holdings(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    for number in 0..GRIDS.len() * 2 {
        let carrier = chance.motion();
        let pose = Pose {
            position: carrier.pose().position + chance.vector(3.0),
            rotation: chance.rotation(),
        };
        let body = motion(pose, chance.motion().twist());
        cases.push(case(number % GRIDS.len(), &carrier, &body));
    }
    let body = chance.motion();
    for carrier in edges() {
        cases.push(case(0, &carrier, &body));
        cases.push(case(6, &body, &carrier));
        cases.push(case(3, &carrier, &carrier));
    }
    cases
}

fn edges() -> Vec<Motion> {
    let at = |position, rotation, linear, angular| {
        motion(Pose { position, rotation }, Twist { linear, angular })
    };
    let (zero, minus_zero) = (DVec3::ZERO, -DVec3::ZERO);
    let half = |x, y, z| DQuat::from_xyzw(x, y, z, -0.0);
    vec![
        Motion::IDENTITY,
        at(minus_zero, -DQuat::IDENTITY, minus_zero, minus_zero),
        at(DVec3::Z, half(1.0, 0.0, -0.0), DVec3::X, DVec3::NEG_Y),
        at(DVec3::X, half(0.0, -1.0, 0.0), minus_zero, DVec3::Z * 50.0),
        at(
            DVec3::splat(1.0e9),
            DQuat::IDENTITY,
            zero,
            DVec3::splat(1.0e9),
        ),
        at(
            DVec3::splat(-3.0e38),
            half(0.0, 0.0, 1.0),
            zero,
            DVec3::splat(3.0e38),
        ),
    ]
}

fn case(index: usize, carrier: &Motion, body: &Motion) -> Case {
    let grid = grid(index);
    let seen = seen_from(&carrier.pose(), &body.pose());
    let said = Snapped::of(&seen, &grid);
    let again = carried(carrier, &said.motion(&grid).pose());
    let case = Case::new()
        .integer("grid", index as i64)
        .doubles("carrier", &thirteen(carrier))
        .doubles("body", &thirteen(body))
        .doubles("seen", &thirteen(&seen));
    snapped(case, &said, &grid).doubles("carried", &thirteen(&again))
}
