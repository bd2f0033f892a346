//! The closed list of predictors of a body's motion.
//!
//! Every subscriber must compute the same bits from the same motion: the arithmetic is normative (RECKONING 3). The
//! publisher chooses the predictor; the choice is not made here. The numbers of a constant acceleration are exact in f64,
//! so that it needs no grid (RECKONING 3.9); its cause (a thruster, a brake, a spring) is not known here.

use glam::DVec3;

use crate::exact::{add3, length3, normalised, product, scale3, turn_about};
use crate::free_motion::{
    Inertia, RotationCursor, RotationState, StepCoefficientTable, StepCoefficients, StepConstants,
    TorqueFreeRotation,
};
use crate::motion::{Motion, Pose, Spare, Twist};
use crate::units::{Rate, Seconds, Ticks};

/// Divergence time of a rest prediction in ticks, at most. A body that starts to move gets an update soon, however
/// long it lay.
pub const REST_DIVERGENCE_TICKS: Ticks = Ticks::new(3);

/// Continues a body's last published motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Predictor {
    /// The body stays where it is.
    Rest,
    /// The body keeps its velocities, less its damping.
    Uniform,
    /// The body falls with the scene's gravity and keeps its spin, less its damping.
    Ballistic,
    /// The body keeps its velocity and rotates free of torque by its moments of inertia, less its damping.
    TorqueFree,
    /// The body falls with the scene's gravity and rotates free of torque, less its damping.
    BallisticTorqueFree,
    /// A constant acceleration replaces gravity for some ticks. The body rotates free of torque, less its damping.
    Accelerated(ConstantAcceleration),
}

/// Acceleration of a predicted body, and its effect up to a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pull {
    /// m/s², world frame.
    pub(crate) acceleration: DVec3,
    /// Factor on the way, s², and on the velocity, s.
    pub(crate) fall: f64,
    pub(crate) fall_velocity: f64,
}

/// Properties of a body that a prediction needs beside its motion.
#[derive(Clone, Copy, Debug)]
pub struct Conditions<'a> {
    /// Acceleration by gravity, m/s², world frame.
    pub gravity: DVec3,
    /// The table of its damping, computed at least to the elapsed ticks; beyond the last row a body keeps that row's
    /// motion.
    pub flow: &'a StepCoefficientTable,
    /// Moments of inertia; without them a body keeps its spin even under a torque-free predictor.
    pub inertia: Option<&'a Inertia>,
}

/// Motion of a free body in some ticks, at unit velocities and unit acceleration.
#[derive(Clone, Copy, Debug)]
pub struct UnforcedMotion {
    /// Metres at 1 m/s.
    pub reach: f64,
    /// Radians at 1 rad/s, at slow spins.
    pub turn: f64,
    /// Metres under 1 m/s².
    pub fall: f64,
}

impl Conditions<'_> {
    /// Displacement and turn of a free body in `elapsed` ticks.
    #[must_use]
    pub fn unforced(&self, elapsed: Ticks) -> UnforcedMotion {
        let (row, config) = self.flow.row(elapsed);
        UnforcedMotion {
            reach: row.reach,
            turn: row.turns[0] * config.dt,
            fall: row.fall,
        }
    }

    /// The acceleration that leads from one velocity to another in a tick: m/s². The table has the row of one tick.
    #[must_use]
    pub fn acceleration(&self, before: DVec3, after: DVec3) -> DVec3 {
        let (row, _) = self.flow.row(Ticks::new(1));
        (after - before * row.velocity) / row.fall_velocity
    }
}

impl Predictor {
    /// Every predictor, in the order of the list; the last with a sample acceleration.
    pub const ALL: [Self; 6] = [
        Self::Rest,
        Self::Uniform,
        Self::Ballistic,
        Self::TorqueFree,
        Self::BallisticTorqueFree,
        Self::Accelerated(ConstantAcceleration::SAMPLE),
    ];

    /// The motion `elapsed` ticks after `start`.
    ///
    /// A torque-free predictor takes one step per elapsed tick: for queries tick by tick, keep a [`RotationCursor`].
    #[must_use]
    pub fn predict(self, start: &Motion, elapsed: Ticks, conditions: &Conditions<'_>) -> Motion {
        self.carry(start, elapsed, conditions, TorqueFreeRotation::after)
    }

    /// The same bits as [`Self::predict`]; results in the cursor are not computed again.
    #[must_use]
    pub fn predict_with(
        self,
        start: &Motion,
        elapsed: Ticks,
        conditions: &Conditions<'_>,
        cursor: &mut RotationCursor,
    ) -> Motion {
        self.carry(
            start,
            elapsed,
            conditions,
            |spin, elapsed, inertia, config| cursor.after(spin, elapsed, inertia, config),
        )
    }

    /// True if it depends on gravity.
    #[must_use]
    pub const fn falls(self) -> bool {
        matches!(self, Self::Ballistic | Self::BallisticTorqueFree)
    }

    /// True if it depends on the moments of inertia.
    #[must_use]
    pub const fn is_torque_free(self) -> bool {
        matches!(
            self,
            Self::TorqueFree | Self::BallisticTorqueFree | Self::Accelerated(_)
        )
    }

    /// Its constant acceleration.
    #[must_use]
    pub const fn acceleration(self) -> Option<ConstantAcceleration> {
        match self {
            Self::Accelerated(acceleration) => Some(acceleration),
            _ => None,
        }
    }

    /// The acceleration of a body `elapsed` ticks after the track's origin, if there is one.
    #[inline]
    pub(crate) fn pull(self, elapsed: Ticks, conditions: &Conditions<'_>) -> Option<Pull> {
        match self {
            Self::Rest | Self::Uniform | Self::TorqueFree => None,
            Self::Ballistic | Self::BallisticTorqueFree => {
                let (row, _) = conditions.flow.row(elapsed);
                Some(Pull {
                    acceleration: conditions.gravity,
                    fall: row.fall,
                    fall_velocity: row.fall_velocity,
                })
            }
            Self::Accelerated(acceleration) => {
                let (fall, fall_velocity) = conditions.flow.ended(elapsed, ACCELERATION_TICKS);
                Some(Pull {
                    acceleration: acceleration.acceleration(),
                    fall,
                    fall_velocity,
                })
            }
        }
    }

    /// Time in which a prediction of this age has diverged (RECKONING 4.4).
    ///
    /// Above zero: a prediction of age zero counts as one of one tick.
    #[must_use]
    pub fn divergence_time(self, age: Ticks, rate: Rate) -> Seconds {
        let ticks = match self {
            Self::Rest => age.min(REST_DIVERGENCE_TICKS),
            _ => age,
        };
        Seconds::new(f64::from(ticks.count().max(1)) * rate.step().seconds())
    }

    fn carry(
        self,
        start: &Motion,
        elapsed: Ticks,
        conditions: &Conditions<'_>,
        torque_free_rotation: impl FnOnce(
            RotationState,
            Ticks,
            &Inertia,
            &StepConstants,
        ) -> RotationState,
    ) -> Motion {
        if self == Self::Rest {
            return start.stilled();
        }
        let elapsed = conditions.flow.within(elapsed);
        let (row, config) = conditions.flow.row(elapsed);
        let Pose { position, rotation } = start.pose();
        let Twist { linear, angular } = start.twist();
        let (mut position, mut linear) = (
            add3(position, scale3(linear, row.reach)),
            scale3(linear, row.velocity),
        );
        if let Some(pull) = self.pull(elapsed, conditions) {
            position = add3(position, scale3(pull.acceleration, pull.fall));
            linear = add3(linear, scale3(pull.acceleration, pull.fall_velocity));
        }
        let turns = || elapsed > Ticks::ZERO && length3(angular) > 0.0;
        let (rotation, angular) = match conditions.inertia {
            Some(inertia) if self.is_torque_free() && turns() => {
                torque_free_rotation((rotation, angular), elapsed, inertia, config)
            }
            _ => spun((rotation, angular), row, config),
        };
        Motion::from_checked(Pose { position, rotation }, Twist { linear, angular })
    }
}

/// Rotation of a body that keeps its axis of spin (RECKONING 3.6).
fn spun(
    (rotation, angular): RotationState,
    row: &StepCoefficients,
    config: &StepConstants,
) -> RotationState {
    let speed = length3(angular);
    let half_angle = row.half_angle(speed, config);
    // Without spin or time the rotation stays the same to the bit; normalising it again could change its last one.
    let rotation = if half_angle == 0.0 {
        rotation
    } else {
        normalised(product(turn_about(angular, speed, half_angle), rotation))
    };
    (rotation, scale3(angular, row.spin))
}

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
    use core::num::NonZeroU32;

    use glam::DQuat;
    use proptest::prelude::*;

    use super::*;
    use crate::free_motion::{Damping, Integrator, TRACK_AGE_MAX};
    use crate::units::Rate;

    fn table() -> StepCoefficientTable {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).unwrap(),
        };
        let mut table = StepCoefficientTable::new(integrator, Damping::default());
        table.extend_to(TRACK_AGE_MAX);
        table
    }

    fn slab() -> Inertia {
        Inertia::new([1.0, 2.0, 2.9], Inertia::OWN_AXES).unwrap()
    }

    /// Conditions of a slab under gravity.
    fn ballistic_torque_free<'a>(
        flow: &'a StepCoefficientTable,
        slab: &'a Inertia,
    ) -> Conditions<'a> {
        Conditions {
            gravity: DVec3::new(0.0, -9.8, 0.0),
            flow,
            inertia: Some(slab),
        }
    }

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    #[test]
    fn divergence_time_is_short_for_rest_and_full_age_otherwise() {
        let rate = Rate::new(50, 1).unwrap();
        let after =
            |predictor: Predictor, age| predictor.divergence_time(Ticks::new(age), rate).seconds();
        for (age, still, moving) in [(0, 1.0, 1.0), (1, 1.0, 1.0), (3, 3.0, 3.0), (90, 3.0, 90.0)] {
            assert_eq!(after(Predictor::Rest, age), still * 0.02);
            assert_eq!(after(Predictor::BallisticTorqueFree, age), moving * 0.02);
        }
    }

    proptest! {
        #[test]
        fn predictions_are_finite(
            position in vector(1e5), linear in vector(1e3), angular in vector(1e3), elapsed in 0_u32..5_000,
        ) {
            let pose = Pose { position, rotation: DQuat::IDENTITY };
            let start = Motion::new(pose, Twist { linear, angular }).unwrap();
            for predictor in Predictor::ALL {
                let end = predictor.predict(&start, Ticks::new(elapsed), &ballistic_torque_free(&table(), &slab()));
                prop_assert!(Motion::new(end.pose(), end.twist()).is_ok());
            }
        }

        #[test]
        fn prediction_after_zero_ticks_is_the_start(
            position in vector(1e5), linear in vector(1e3), angular in vector(1e3),
        ) {
            let rotation = DQuat::from_scaled_axis(angular);
            let start = Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap();
            for predictor in &Predictor::ALL[1..] {
                let predicted = predictor.predict(&start, Ticks::ZERO, &ballistic_torque_free(&table(), &slab()));
                prop_assert_eq!(predicted, start);
            }
            let rest = Predictor::Rest.predict(&start, Ticks::ZERO, &ballistic_torque_free(&table(), &slab()));
            prop_assert_eq!(rest, start.stilled());
        }
    }

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
