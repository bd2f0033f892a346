//! Cases of attached bodies: relative to the parent, quantised, and back.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{Motion, Pose, QuantisedState, Twist, attached_motion, relative_to};

use super::rng::{VectorRng, motion, thirteen};
use super::tolerances::{GRIDS, grid, quantised};
use crate::document::CaseJson;

/// Parents with bodies near them, then edges: no turn, signed zeros, half turns, poses beyond every grid.
pub(super) fn attachments(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = Vec::new();
    for number in 0..GRIDS.len() * 2 {
        let parent = rng.motion();
        let pose = Pose {
            position: parent.pose().position + rng.vector(3.0),
            rotation: rng.rotation(),
        };
        let body = motion(pose, rng.motion().twist());
        cases.push(case(number % GRIDS.len(), &parent, &body));
    }
    let body = rng.motion();
    for parent in edges() {
        cases.push(case(0, &parent, &body));
        cases.push(case(6, &body, &parent));
        cases.push(case(3, &parent, &parent));
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

fn case(index: usize, parent: &Motion, body: &Motion) -> CaseJson {
    let grid = grid(index);
    let relative = relative_to(&parent.pose(), &body.pose());
    let tolerances = QuantisedState::of(&relative, &grid);
    let again = attached_motion(parent, &tolerances.motion(&grid).pose());
    let case = CaseJson::new()
        .integer("grid", index as i64)
        .doubles("parent", &thirteen(parent))
        .doubles("body", &thirteen(body))
        .doubles("relative", &thirteen(&relative));
    quantised(case, &tolerances, &grid).doubles("attached_motion", &thirteen(&again))
}
