//! Constant acceleration of a predicted body.
//!
//! Its cause (a thruster, a brake, a spring) is not known here. Its numbers are exact in f64, so that it needs no grid
//! (RECKONING 3.9).

use glam::DVec3;

use crate::body::Spare;
use crate::tick::Ticks;

/// Longest duration of an acceleration: without an update, a subscriber predicts uniform motion from then on.
pub const ACCELERATION_TICKS: Ticks = Ticks::new(64);
/// Largest number of steps along each axis.
pub const ACCELERATION_LIMIT: i16 = 1_023;
/// Largest exponent: how many times steps can be doubled.
pub const ACCELERATION_EXPONENT_MAX: u8 = 12;
/// The finest step, m/s².
const STEP: f64 = 1.0 / 256.0;

/// Acceleration in the world frame; includes everything that accelerates the body, gravity too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ConstantAcceleration {
    steps: [i16; 3],
    exponent: u8,
    // Keeps a predictor with an acceleration as small as one without.
    spare: Spare,
}

impl ConstantAcceleration {
    /// An example, for code that goes through all predictors.
    pub const SAMPLE: Self = Self {
        steps: [40, -7, 0],
        exponent: 3,
        spare: Spare::Nothing,
    };

    /// `steps` along each axis, doubled `exponent` times; `None` beyond the limits.
    #[must_use]
    pub fn new(steps: [i16; 3], exponent: u8) -> Option<Self> {
        let within = steps
            .iter()
            .all(|steps| (-ACCELERATION_LIMIT..=ACCELERATION_LIMIT).contains(steps));
        (within && exponent <= ACCELERATION_EXPONENT_MAX).then_some(Self {
            steps,
            exponent,
            spare: Spare::Nothing,
        })
    }

    /// The value nearest to an acceleration in m/s²; `None` beyond the limits.
    ///
    /// `fineness`: least number of steps that the greatest component must span; the coarsest such steps are taken.
    /// Only the publisher computes it, so that it need not be exact.
    #[must_use]
    pub fn nearest(acceleration: DVec3, fineness: f64) -> Option<Self> {
        let coarsest = acceleration.abs().max_element() / fineness;
        let finer = |exponent: &u8| step(*exponent) <= coarsest;
        let exponent = (0..=ACCELERATION_EXPONENT_MAX)
            .rev()
            .find(finer)
            .unwrap_or(0);
        let limit = f64::from(ACCELERATION_LIMIT);
        let mut steps = [0; 3];
        for (steps, part) in steps.iter_mut().zip(acceleration.to_array()) {
            let rounded = libm::round(part / step(exponent));
            // NaN is within no range.
            if !(-limit..=limit).contains(&rounded) {
                return None;
            }
            *steps = rounded as i16;
        }
        Self::new(steps, exponent)
    }

    /// Steps along each axis.
    #[must_use]
    pub const fn steps(&self) -> [i16; 3] {
        self.steps
    }

    /// The number of doublings of the steps.
    #[must_use]
    pub const fn exponent(&self) -> u8 {
        self.exponent
    }

    /// The value in two words.
    pub(crate) const fn words(self) -> [u32; 2] {
        let [x, y, z] = self.steps;
        let [x, y, z] = [x as u16 as u32, y as u16 as u32, z as u16 as u32];
        [x | y << 16, z | (self.exponent as u32) << 16]
    }

    /// The value of these words, which are the result of [`Self::words`].
    pub(crate) const fn from_words([low, high]: [u32; 2]) -> Self {
        Self {
            steps: [low as i16, (low >> 16) as i16, high as i16],
            exponent: (high >> 16) as u8,
            spare: Spare::Nothing,
        }
    }

    /// World frame, m/s².
    #[must_use]
    pub fn acceleration(&self) -> DVec3 {
        let step = step(self.exponent);
        let [x, y, z] = self.steps;
        DVec3::new(
            f64::from(x) * step,
            f64::from(y) * step,
            f64::from(z) * step,
        )
    }
}

/// m/s²; a power of two, so that every product with it is exact.
fn step(exponent: u8) -> f64 {
    f64::from(1_u32 << exponent) * STEP
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantised_acceleration_is_a_fixed_point(
            steps in proptest::array::uniform3(-ACCELERATION_LIMIT..=ACCELERATION_LIMIT),
            exponent in 0..=ACCELERATION_EXPONENT_MAX,
        ) {
            let quantised = ConstantAcceleration::new(steps, exponent).unwrap();
            let greatest = steps.map(i16::abs).into_iter().max().unwrap();
            prop_assume!(greatest > 0);
            let again = ConstantAcceleration::nearest(quantised.acceleration(), f64::from(greatest));
            prop_assert_eq!(again, Some(quantised));
        }

        #[test]
        fn quantisation_errs_by_half_a_step_at_most(
            x in 1.0..100.0_f64, y in -100.0..100.0_f64, fineness in 8.0..200.0_f64,
        ) {
            let wanted = DVec3::new(x, y, 0.0);
            let quantised = ConstantAcceleration::nearest(wanted, fineness).unwrap();
            let off = quantised.acceleration() - wanted;
            let step = step(quantised.exponent());
            prop_assert!(off.abs().max_element() <= step * 0.5);
            prop_assert!(step * fineness <= x.max(y.abs()) || quantised.exponent() == 0);
        }
    }

    #[test]
    fn acceleration_beyond_the_limits_is_refused() {
        let most = ACCELERATION_LIMIT;
        assert!(ConstantAcceleration::new([most, -most, 0], ACCELERATION_EXPONENT_MAX).is_some());
        assert!(ConstantAcceleration::new([most + 1, 0, 0], 0).is_none());
        assert!(ConstantAcceleration::new([0, -most - 1, 0], 0).is_none());
        assert!(ConstantAcceleration::new([0; 3], ACCELERATION_EXPONENT_MAX + 1).is_none());
        assert!(ConstantAcceleration::nearest(DVec3::X * 5.0, 4_096.0).is_none());
        assert!(ConstantAcceleration::nearest(DVec3::X * 1e9, 16.0).is_none());
        assert!(ConstantAcceleration::nearest(DVec3::NAN, 16.0).is_none());
    }
}
