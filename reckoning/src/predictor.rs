//! The closed list of predictors that say how a body goes on.
//!
//! Every listener must get the same bits from the same motion, so that the arithmetic is normative (RECKONING 3).
//! Which predictor serves a body best is not decided here: that is the publisher's choice.

use glam::DVec3;

use crate::acceleration::{ACCELERATION_TICKS, ConstantAcceleration};
use crate::exact::{add3, length3, normalised, product, scale3, turn_about};
use crate::flow::{StepCoefficientTable, StepCoefficients, StepConstants};
use crate::inertia::Inertia;
use crate::motion::{Motion, Pose, Twist};
use crate::tick::{Rate, Ticks};
use crate::torque_free_rotation::{RotationCursor, RotationState, TorqueFreeRotation};
use crate::units::Seconds;

/// A body that was still went divergence_time in no more ticks than this, however long it lay: it is spoken of soon after it was
/// set in motion.
pub const REST_DIVERGENCE_TICKS: Ticks = Ticks::new(3);

/// How a body goes on from its last known motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Predictor {
    /// It stays where it is.
    Rest,
    /// It keeps its velocities, less the body's damping.
    Uniform,
    /// It falls with the scene's gravity and keeps its spin, less the body's damping.
    Ballistic,
    /// It keeps its velocity and is_torque_free as its moments of inertia have it, less the body's damping.
    TorqueFree,
    /// It falls with the scene's gravity and is_torque_free, less the body's damping.
    BallisticTorqueFree,
    /// A constant acceleration takes gravity's place for some ticks, and it is_torque_free, less the body's damping.
    Accelerated(ConstantAcceleration),
}

/// What pulls at a body by a predictor, and what that does up to a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pull {
    /// m/s², world frame.
    pub(crate) acceleration: DVec3,
    /// Its share of the way, s², and of the velocity, s.
    pub(crate) fall: f64,
    pub(crate) fall_velocity: f64,
}

/// What a predictor must know of a body beside its motion.
#[derive(Clone, Copy, Debug)]
pub struct Conditions<'a> {
    /// What pulls at it, m/s², world frame.
    pub gravity: DVec3,
    /// The table of its damping, computed at least to the ticks that are asked for: beyond its last row a body holds
    /// the motion of that row.
    pub flow: &'a StepCoefficientTable,
    /// How it resists being turned; a body of which none is known keeps its spin where another would torque_free_rotation.
    pub inertia: Option<&'a Inertia>,
}

/// How far a free body gets in some ticks, at velocities and under an acceleration of one.
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
    /// How far a body gets in so many ticks.
    #[must_use]
    pub fn unforced(&self, elapsed: Ticks) -> UnforcedMotion {
        let (row, config) = self.flow.row(elapsed);
        UnforcedMotion {
            reach: row.reach,
            turn: row.turns[0] * config.dt,
            fall: row.fall,
        }
    }

    /// The acceleration that brings one velocity to another in a tick: m/s². The table has the row of one tick.
    #[must_use]
    pub fn acceleration(&self, before: DVec3, after: DVec3) -> DVec3 {
        let (row, _) = self.flow.row(Ticks::new(1));
        (after - before * row.velocity) / row.fall_velocity
    }
}

impl Predictor {
    /// Every predictor, in the order of the list; the last with one push of many.
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
    /// A torque_free predictor takes as many steps as ticks have elapsed: who asks tick by tick keeps a [`RotationCursor`] instead.
    #[must_use]
    pub fn predict(self, start: &Motion, elapsed: Ticks, conditions: &Conditions<'_>) -> Motion {
        self.carry(start, elapsed, conditions, TorqueFreeRotation::after)
    }

    /// The same bits; what the cursor has computed is not computed again.
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

    /// Whether gravity enters it.
    #[must_use]
    pub const fn falls(self) -> bool {
        matches!(self, Self::Ballistic | Self::BallisticTorqueFree)
    }

    /// Whether moments of inertia enter it.
    #[must_use]
    pub const fn is_torque_free(self) -> bool {
        matches!(
            self,
            Self::TorqueFree | Self::BallisticTorqueFree | Self::Accelerated(_)
        )
    }

    /// The push that it goes by.
    #[must_use]
    pub const fn acceleration(self) -> Option<ConstantAcceleration> {
        match self {
            Self::Accelerated(push) => Some(push),
            _ => None,
        }
    }

    /// What pulls at a body `elapsed` ticks after it was said, if anything does.
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
            Self::Accelerated(push) => {
                let (fall, fall_velocity) = conditions.flow.ended(elapsed, ACCELERATION_TICKS);
                Some(Pull {
                    acceleration: push.acceleration(),
                    fall,
                    fall_velocity,
                })
            }
        }
    }

    /// In what time a prediction by this predictor, `age` ticks old, went divergence_time (RECKONING 4.4).
    ///
    /// More than nothing: a prediction that is no tick old counts as one of one tick.
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

/// What keeps its axis of spin (RECKONING 3.6).
fn spun(
    (rotation, angular): RotationState,
    row: &StepCoefficients,
    config: &StepConstants,
) -> RotationState {
    let speed = length3(angular);
    let half_angle = row.half_angle(speed, config);
    // Without spin or time the said rotation stands to the bit; normalising it again could move its last one.
    let rotation = if half_angle == 0.0 {
        rotation
    } else {
        normalised(product(turn_about(angular, speed, half_angle), rotation))
    };
    (rotation, scale3(angular, row.spin))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::{Damping, Integrator, TRACK_AGE_MAX};
    use crate::tick::Rate;
    use core::num::NonZeroU32;
    use glam::DQuat;
    use proptest::prelude::*;

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

    /// Of a slab under gravity.
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
        fn prediction_after_zero_ticks_is_the_start(position in vector(1e5), linear in vector(1e3), angular in vector(1e3)) {
            let rotation = DQuat::from_scaled_axis(angular);
            let start = Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap();
            for predictor in &Predictor::ALL[1..] {
                prop_assert_eq!(predictor.predict(&start, Ticks::ZERO, &ballistic_torque_free(&table(), &slab())), start);
            }
            let rest = Predictor::Rest.predict(&start, Ticks::ZERO, &ballistic_torque_free(&table(), &slab()));
            prop_assert_eq!(rest, start.stilled());
        }
    }
}
