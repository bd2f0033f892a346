//! The closed list of laws that say how a body goes on.
//!
//! Every listener must get the same bits from the same motion, so that the arithmetic is normative (RECKONING 3).
//! Which law serves a body best is not decided here: that is the publisher's choice.

use glam::DVec3;

use crate::exact::{add3, length3, normalised, product, scale3, turn_about};
use crate::flow::{Flow, FlowTable, FlowTerms};
use crate::inertia::Inertia;
use crate::motion::{Motion, Pose, Twist};
use crate::push::{PUSH_TICKS, Push};
use crate::tick::{Rate, Ticks};
use crate::tumble::{Cursor, Spin, Tumble};
use crate::units::Seconds;

/// A body that was still went astray in no more ticks than this, however long it lay: it is spoken of soon after it was
/// set in motion.
pub const REST_ASTRAY: Ticks = Ticks::new(3);

/// How a body goes on from its last known motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Predictor {
    /// It stays where it is.
    Rest,
    /// It keeps its velocities, less the body's damping.
    Uniform,
    /// It falls with the scene's gravity and keeps its spin, less the body's damping.
    Ballistic,
    /// It keeps its velocity and tumbles as its moments of inertia have it, less the body's damping.
    Tumbling,
    /// It falls with the scene's gravity and tumbles, less the body's damping.
    Thrown,
    /// A constant acceleration takes gravity's place for some ticks, and it tumbles, less the body's damping.
    Pushed(Push),
}

/// What pulls at a body by a law, and what that does up to a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pull {
    /// m/s², world frame.
    pub(crate) acceleration: DVec3,
    /// Its share of the way, s², and of the velocity, s.
    pub(crate) fall: f64,
    pub(crate) fall_velocity: f64,
}

/// What a law must know of a body beside its motion.
#[derive(Clone, Copy, Debug)]
pub struct Conditions<'a> {
    /// What pulls at it, m/s², world frame.
    pub gravity: DVec3,
    /// The table of its damping, computed at least to the ticks that are asked for: beyond its last row a body holds
    /// the motion of that row.
    pub flow: &'a FlowTable,
    /// How it resists being turned; a body of which none is known keeps its spin where another would tumble.
    pub inertia: Option<&'a Inertia>,
}

impl Conditions<'_> {
    /// How far a body that a pull of 1 m/s² acts on is from one that nothing pulls at, after so many ticks: metres.
    #[must_use]
    pub fn fall(&self, elapsed: Ticks) -> f64 {
        let (row, _) = self.flow.row(elapsed);
        row.fall
    }

    /// The acceleration that brings one velocity to another in a tick: m/s². The table has the row of one tick.
    #[must_use]
    pub fn acceleration(&self, before: DVec3, after: DVec3) -> DVec3 {
        let (row, _) = self.flow.row(Ticks::new(1));
        (after - before * row.velocity) / row.fall_velocity
    }
}

impl Predictor {
    /// Every law, in the order of the list; the last with one push of many.
    pub const ALL: [Self; 6] = [
        Self::Rest,
        Self::Uniform,
        Self::Ballistic,
        Self::Tumbling,
        Self::Thrown,
        Self::Pushed(Push::SAMPLE),
    ];

    /// The motion `elapsed` ticks after `start`.
    ///
    /// A tumbling law takes as many steps as ticks have elapsed: who asks tick by tick keeps a [`Cursor`] instead.
    #[must_use]
    pub fn predict(self, start: &Motion, elapsed: Ticks, conditions: &Conditions<'_>) -> Motion {
        self.carry(start, elapsed, conditions, Tumble::after)
    }

    /// The same bits; what the cursor has computed is not computed again.
    #[must_use]
    pub fn predict_with(
        self,
        start: &Motion,
        elapsed: Ticks,
        conditions: &Conditions<'_>,
        cursor: &mut Cursor,
    ) -> Motion {
        self.carry(
            start,
            elapsed,
            conditions,
            |spin, elapsed, inertia, terms| cursor.after(spin, elapsed, inertia, terms),
        )
    }

    /// Whether gravity enters it.
    #[must_use]
    pub const fn falls(self) -> bool {
        matches!(self, Self::Ballistic | Self::Thrown)
    }

    /// Whether moments of inertia enter it.
    #[must_use]
    pub const fn tumbles(self) -> bool {
        matches!(self, Self::Tumbling | Self::Thrown | Self::Pushed(_))
    }

    /// The push that it goes by.
    #[must_use]
    pub const fn push(self) -> Option<Push> {
        match self {
            Self::Pushed(push) => Some(push),
            _ => None,
        }
    }

    /// What pulls at a body `elapsed` ticks after it was said, if anything does.
    #[inline]
    pub(crate) fn pull(self, elapsed: Ticks, conditions: &Conditions<'_>) -> Option<Pull> {
        match self {
            Self::Rest | Self::Uniform | Self::Tumbling => None,
            Self::Ballistic | Self::Thrown => {
                let (row, _) = conditions.flow.row(elapsed);
                Some(Pull {
                    acceleration: conditions.gravity,
                    fall: row.fall,
                    fall_velocity: row.fall_velocity,
                })
            }
            Self::Pushed(push) => {
                let (fall, fall_velocity) = conditions.flow.ended(elapsed, PUSH_TICKS);
                Some(Pull {
                    acceleration: push.acceleration(),
                    fall,
                    fall_velocity,
                })
            }
        }
    }

    /// In what time a prediction by this law, `age` ticks old, went astray (RECKONING 4.4).
    ///
    /// More than nothing: a prediction that is no tick old counts as one of one tick.
    #[must_use]
    pub fn astray(self, age: Ticks, rate: Rate) -> Seconds {
        let ticks = match self {
            Self::Rest => age.min(REST_ASTRAY),
            _ => age,
        };
        Seconds::new(f64::from(ticks.count().max(1)) * rate.step().seconds())
    }

    fn carry(
        self,
        start: &Motion,
        elapsed: Ticks,
        conditions: &Conditions<'_>,
        tumble: impl FnOnce(Spin, Ticks, &Inertia, &FlowTerms) -> Spin,
    ) -> Motion {
        if self == Self::Rest {
            return start.stilled();
        }
        let elapsed = conditions.flow.within(elapsed);
        let (row, terms) = conditions.flow.row(elapsed);
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
            Some(inertia) if self.tumbles() && turns() => {
                tumble((rotation, angular), elapsed, inertia, terms)
            }
            _ => spun((rotation, angular), row, terms),
        };
        Motion::from_checked(Pose { position, rotation }, Twist { linear, angular })
    }
}

/// What keeps its axis of spin (RECKONING 3.6).
fn spun((rotation, angular): Spin, row: &Flow, terms: &FlowTerms) -> Spin {
    let speed = length3(angular);
    let half_angle = row.half_angle(speed, terms);
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
    use crate::flow::{Damping, HORIZON, Integrator};
    use crate::tick::Rate;
    use core::num::NonZeroU32;
    use glam::DQuat;
    use proptest::prelude::*;

    fn table() -> FlowTable {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).unwrap(),
        };
        let mut table = FlowTable::new(integrator, Damping::default());
        table.extend_to(HORIZON);
        table
    }

    fn slab() -> Inertia {
        Inertia::new([1.0, 2.0, 2.9], Inertia::OWN_AXES).unwrap()
    }

    /// Of a slab under gravity.
    fn thrown<'a>(flow: &'a FlowTable, slab: &'a Inertia) -> Conditions<'a> {
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
    fn what_lay_still_went_astray_of_late_and_what_moved_all_along() {
        let rate = Rate::new(50, 1).unwrap();
        let after = |law: Predictor, age| law.astray(Ticks::new(age), rate).seconds();
        for (age, still, moving) in [(0, 1.0, 1.0), (1, 1.0, 1.0), (3, 3.0, 3.0), (90, 3.0, 90.0)] {
            assert_eq!(after(Predictor::Rest, age), still * 0.02);
            assert_eq!(after(Predictor::Thrown, age), moving * 0.02);
        }
    }

    proptest! {
        #[test]
        fn no_prediction_is_ever_not_finite(
            position in vector(1e5), linear in vector(1e3), angular in vector(1e3), elapsed in 0_u32..5_000,
        ) {
            let pose = Pose { position, rotation: DQuat::IDENTITY };
            let start = Motion::new(pose, Twist { linear, angular }).unwrap();
            for law in Predictor::ALL {
                let end = law.predict(&start, Ticks::new(elapsed), &thrown(&table(), &slab()));
                prop_assert!(Motion::new(end.pose(), end.twist()).is_ok());
            }
        }

        #[test]
        fn nothing_has_moved_after_no_time(position in vector(1e5), linear in vector(1e3), angular in vector(1e3)) {
            let rotation = DQuat::from_scaled_axis(angular);
            let start = Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap();
            for law in &Predictor::ALL[1..] {
                prop_assert_eq!(law.predict(&start, Ticks::ZERO, &thrown(&table(), &slab())), start);
            }
            let rest = Predictor::Rest.predict(&start, Ticks::ZERO, &thrown(&table(), &slab()));
            prop_assert_eq!(rest, start.stilled());
        }
    }
}
