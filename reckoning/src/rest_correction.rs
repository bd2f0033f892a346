//! A pose at rest to the engine's own bits, as a correction of a prediction.
//!
//! Lossless: any pose can be coded, and poses near the prediction are short. A step leads to the neighbouring f32: it
//! is as fine as the number at hand (RECKONING 4.7).

use crate::exact::sqrt;
use crate::motion::{InvalidMotion, Pose};
use crate::quantiser::OTHERS;
use crate::track::BodyState;

/// Difference between the f32 of a pose and those of its prediction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct RestCorrection {
    /// True if the quaternion is nearer to the negative of the predicted one.
    pub negated: bool,
    /// Steps of position.
    pub position: [i32; 3],
    /// Steps of the three parts of the quaternion that are not the greatest of the predicted one, in order.
    pub others: [i32; 3],
    /// Steps of that one.
    pub largest: i32,
}

/// A rest correction has fewer steps than this in each number.
const REACH: i64 = 1 << 31;

impl RestCorrection {
    /// The correction that leads from a predicted to a true pose; `None` where they are too far apart.
    #[must_use]
    pub fn of(truth: &BodyState, predicted: &Pose) -> Option<Self> {
        let (position, rotation) = (truth.position(), truth.rotation());
        let expected = predicted.rotation.to_array();
        let place = greatest(expected);
        let negated = (rotation[place] < 0.0) != (expected[place] < 0.0);
        let expected = expected.map(|part| if negated { -part } else { part });
        let parts = OTHERS[place].map(|i| rotation[i]);
        let guess = greatest_of(parts, expected[place]);
        let position_guess = predicted.position.to_array();
        let mut rest_correction = Self {
            negated,
            largest: steps(rotation[place], guess)?,
            ..Self::default()
        };
        for i in 0..3 {
            rest_correction.position[i] = steps(position[i], position_guess[i] as f32)?;
            rest_correction.others[i] = steps(parts[i], expected[OTHERS[place][i]] as f32)?;
        }
        Some(rest_correction)
    }

    /// The pose at rest that this correction makes of a predicted one.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`] if the result is not a pose.
    pub fn onto(&self, predicted: &Pose) -> Result<BodyState, InvalidMotion> {
        let expected = predicted.rotation.to_array();
        let place = greatest(expected);
        let expected = expected.map(|part| if self.negated { -part } else { part });
        let guess = predicted.position.to_array();
        let position = core::array::from_fn(|i| stepped(guess[i] as f32, self.position[i]));
        let places = OTHERS[place];
        let parts: [f32; 3] =
            core::array::from_fn(|i| stepped(expected[places[i]] as f32, self.others[i]));
        let mut rotation = [0.0; 4];
        for (place, part) in places.into_iter().zip(parts) {
            rotation[place] = part;
        }
        rotation[place] = stepped(greatest_of(parts, expected[place]), self.largest);
        BodyState::new(position, rotation, [0.0; 3], [0.0; 3])
    }
}

/// The place of the part that is greatest in size; the first among equals.
fn greatest(parts: [f64; 4]) -> usize {
    let mut place = 0;
    for i in 1..4 {
        if parts[i].abs() > parts[place].abs() {
            place = i;
        }
    }
    place
}

/// The fourth part of a unit quaternion, from the three others and with the sign of the expected value.
fn greatest_of(parts: [f32; 3], expected: f64) -> f32 {
    let [a, b, c] = parts.map(f64::from);
    let rest = 1.0 - ((a * a + b * b) + c * c);
    // Written so that NaN gives zero too.
    let size = if rest > 0.0 { sqrt(rest) } else { 0.0 };
    (if expected < 0.0 { -size } else { size }) as f32
}

/// The rank of an f32 among all: −0 is −1 and 0 is 0.
const fn rank(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { bits ^ i32::MAX } else { bits }
}

/// The number of f32 between two values.
fn steps(to: f32, from: f32) -> Option<i32> {
    let by = i64::from(rank(to)) - i64::from(rank(from));
    (by.abs() < REACH).then_some(by as i32)
}

/// The f32 that is `by` ranks further; it wraps around at the ends.
const fn stepped(from: f32, by: i32) -> f32 {
    let rank = rank(from).wrapping_add(by);
    let bits = if rank < 0 { rank ^ i32::MAX } else { rank };
    f32::from_bits(bits as u32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose> {
        let place = proptest::array::uniform3(-1e5_f64..1e5).prop_map(DVec3::from_array);
        let rotation = proptest::array::uniform4(-1.0_f64..1.0).prop_filter_map("too short", |q| {
            let q = DQuat::from_array(q);
            (q.length() > 0.1).then(|| q.normalize())
        });
        (place, rotation).prop_map(|(position, rotation)| Pose { position, rotation })
    }

    fn resting(pose: &Pose) -> BodyState {
        BodyState::new(
            pose.position.as_vec3().to_array(),
            pose.rotation.to_array().map(|part| part as f32),
            [0.0; 3],
            [0.0; 3],
        )
        .unwrap()
    }

    proptest! {
        #[test]
        fn rest_correction_round_trips(truth in pose(), predicted in pose()) {
            let truth = resting(&truth);
            if let Some(rest_correction) = RestCorrection::of(&truth, &predicted) {
                prop_assert_eq!(rest_correction.onto(&predicted), Ok(truth));
            }
        }

        #[test]
        fn good_predictions_need_small_steps(predicted in pose(), negated in any::<bool>()) {
            let sign = if negated { -1.0 } else { 1.0 };
            let truth = resting(&Pose { rotation: predicted.rotation * sign, ..predicted });
            let rest_correction = RestCorrection::of(&truth, &predicted).unwrap();
            let steps = (rest_correction.negated, rest_correction.position, rest_correction.others);
            prop_assert_eq!(steps, (negated, [0; 3], [0; 3]));
            prop_assert!(rest_correction.largest.abs() <= 1, "{}", rest_correction.largest);
        }
    }

    #[test]
    fn the_sign_of_a_zero_is_a_step() {
        assert_eq!((rank(0.0), rank(-0.0), rank(f32::from_bits(1))), (0, -1, 1));
        assert_eq!(stepped(0.0, -1).to_bits(), (-0.0_f32).to_bits());
    }

    #[test]
    fn invalid_poses_are_refused() {
        let far = RestCorrection {
            position: [rank(f32::INFINITY), 0, 0],
            ..RestCorrection::default()
        };
        let origin = Pose::IDENTITY;
        assert_eq!(far.onto(&origin), Err(InvalidMotion::Position));
        let long = RestCorrection {
            largest: rank(2.0) - rank(1.0),
            ..RestCorrection::default()
        };
        assert_eq!(long.onto(&origin), Err(InvalidMotion::Rotation));
    }
}
