//! Cases of exact rest, coded as a correction of a prediction.

use glam::DQuat;
use rhumb_reckoning::{Motion, Pose, RestCorrection, Twist};

use super::rng::{VectorRng, motion, thirteen};
use crate::document::CaseJson;

/// Steps of every size, of either sign of the quaternion; then edges: ties, zeros, and invalid poses.
pub(super) fn rest_corrections(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = Vec::new();
    for (number, most) in [0, 1, 40, 5_000, 90_000]
        .into_iter()
        .cycle()
        .take(20)
        .enumerate()
    {
        let mut steps = || core::array::from_fn(|_| rng.steps(most));
        let (position, others) = (steps(), steps());
        let rest_correction = RestCorrection {
            negated: number % 2 == 1,
            position,
            others,
            largest: rng.steps(most.min(2)),
        };
        cases.push(case(&rng.motion(), &rest_correction));
    }
    for predicted in edges() {
        for negated in [false, true] {
            let rest_correction = RestCorrection {
                negated,
                position: [1, -1, 0],
                others: [0, 2, -3],
                largest: 1,
            };
            cases.push(case(&predicted, &rest_correction));
        }
    }
    for rest_correction in refused() {
        cases.push(case(&Motion::IDENTITY, &rest_correction));
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
fn refused() -> [RestCorrection; 3] {
    let none = RestCorrection::default();
    [
        RestCorrection {
            position: [i32::MAX, 0, 0],
            ..none
        },
        RestCorrection {
            others: [0x4000_0000, 0, 0],
            ..none
        },
        RestCorrection {
            largest: 1 << 23,
            ..none
        },
    ]
}

fn case(predicted: &Motion, rest_correction: &RestCorrection) -> CaseJson {
    let case = CaseJson::new()
        .doubles("predicted", &thirteen(predicted))
        .integer("negated", rest_correction.negated)
        .integers("position_steps", &rest_correction.position)
        .integers("others_steps", &rest_correction.others)
        .integers("largest_step", &[rest_correction.largest]);
    match rest_correction.onto(&predicted.pose()) {
        Ok(body_state) => case.singles("body_state", &body_state.parts()),
        Err(_) => case.nothing("body_state"),
    }
}
