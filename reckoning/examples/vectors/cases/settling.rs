//! Cases of rest to the engine's own bits, as a correction of a prediction

use glam::DQuat;
use rhumb_reckoning::{Motion, Pose, Settling, Twist};

use super::chance::{Chance, motion, thirteen};
use crate::document::Case;

/// Steps of every size, of either sign of the quaternion; then edges: ties, zeros, and what is no pose.
pub(super) fn settlings(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    for (number, most) in [0, 1, 40, 5_000, 90_000]
        .into_iter()
        .cycle()
        .take(20)
        .enumerate()
    {
        let mut steps = || core::array::from_fn(|_| chance.steps(most));
        let (position, others) = (steps(), steps());
        let settling = Settling {
            negated: number % 2 == 1,
            position,
            others,
            largest: chance.steps(most.min(2)),
        };
        cases.push(case(&chance.motion(), &settling));
    }
    for predicted in edges() {
        for negated in [false, true] {
            let settling = Settling {
                negated,
                position: [1, -1, 0],
                others: [0, 2, -3],
                largest: 1,
            };
            cases.push(case(&predicted, &settling));
        }
    }
    for settling in refused() {
        cases.push(case(&Motion::IDENTITY, &settling));
    }
    cases
}

fn edges() -> Vec<Motion> {
    let half = 0.5_f64;
    let root = half.sqrt();
    [
        [0.0, 0.0, 0.0, 1.0],
        [-0.0, 0.0, -0.0, -1.0],
        [half, -half, half, -half],
        [root, 0.0, -root, 0.0],
        [0.0, -root, root, 0.0],
    ]
    .map(|parts| {
        let rotation = DQuat::from_array(parts);
        let position = glam::DVec3::new(-0.0, 1.0e-41, 16_777_217.0);
        motion(Pose { position, rotation }, Twist::ZERO)
    })
    .to_vec()
}

/// A position that is not finite, and rotations that are not of unit length.
fn refused() -> [Settling; 3] {
    let none = Settling::default();
    [
        Settling {
            position: [i32::MAX, 0, 0],
            ..none
        },
        Settling {
            others: [0x4000_0000, 0, 0],
            ..none
        },
        Settling {
            largest: 1 << 23,
            ..none
        },
    ]
}

fn case(predicted: &Motion, settling: &Settling) -> Case {
    let case = Case::new()
        .doubles("predicted", &thirteen(predicted))
        .integer("negated", settling.negated)
        .integers("position_steps", &settling.position)
        .integers("others_steps", &settling.others)
        .integers("largest_step", &[settling.largest]);
    match settling.onto(&predicted.pose()) {
        Ok(verbatim) => case.singles("verbatim", &verbatim.parts()),
        Err(_) => case.nothing("verbatim"),
    }
}
