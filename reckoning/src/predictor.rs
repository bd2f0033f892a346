//! The closed list of laws that say how a body goes on.
//!
//! Every listener must get the same bits from the same motion, so that the arithmetic is normative (RECKONING 3).
//! Which law serves a body best is not decided here: that is the publisher's choice.

use glam::DVec3;

use crate::exact::{add3, length3, normalised, product, scale3, turn_about};
use crate::flow::FlowTable;
use crate::motion::{Motion, Pose, Twist};
use crate::tick::Ticks;

/// How a body goes on from its last known motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Predictor {
    /// It stays where it is.
    Rest,
    /// It keeps its velocities, less the body's damping.
    Uniform,
    /// It falls with the scene's gravity and keeps its spin, less the body's damping.
    Ballistic,
}

impl Predictor {
    /// The motion `elapsed` ticks after `start`.
    ///
    /// `gravity`: what pulls at this body, m/s², world frame. `flow`: the table of the body's damping, computed at
    /// least to `elapsed`; beyond its last row the body holds the motion of that row.
    #[must_use]
    pub fn predict(
        self,
        start: &Motion,
        elapsed: Ticks,
        gravity: DVec3,
        flow: &FlowTable,
    ) -> Motion {
        let (row, terms) = flow.row(elapsed);
        let Pose { position, rotation } = start.pose();
        let Twist { linear, angular } = start.twist();
        let travelled = add3(position, scale3(linear, row.reach));
        let kept = scale3(linear, row.velocity);
        let (position, linear) = match self {
            Self::Rest => return start.stilled(),
            Self::Uniform => (travelled, kept),
            Self::Ballistic => (
                add3(travelled, scale3(gravity, row.fall)),
                add3(kept, scale3(gravity, row.fall_velocity)),
            ),
        };
        let speed = length3(angular);
        let half_angle = row.half_angle(speed, terms);
        // Without spin or time the said rotation stands to the bit; normalising it again could move its last one.
        let rotation = if half_angle == 0.0 {
            rotation
        } else {
            normalised(product(turn_about(angular, speed, half_angle), rotation))
        };
        let angular = scale3(angular, row.spin);
        Motion::from_checked(Pose { position, rotation }, Twist { linear, angular })
    }
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

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn no_prediction_is_ever_not_finite(
            position in vector(1e5), linear in vector(1e3), angular in vector(1e3), elapsed in 0_u32..5_000,
        ) {
            let pose = Pose { position, rotation: DQuat::IDENTITY };
            let start = Motion::new(pose, Twist { linear, angular }).unwrap();
            for law in [Predictor::Rest, Predictor::Uniform, Predictor::Ballistic] {
                let end = law.predict(&start, Ticks::new(elapsed), DVec3::new(0.0, -9.8, 0.0), &table());
                prop_assert!(Motion::new(end.pose(), end.twist()).is_ok());
            }
        }

        #[test]
        fn nothing_has_moved_after_no_time(position in vector(1e5), linear in vector(1e3), angular in vector(1e3)) {
            let rotation = DQuat::from_scaled_axis(angular);
            let start = Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap();
            for law in [Predictor::Uniform, Predictor::Ballistic] {
                prop_assert_eq!(law.predict(&start, Ticks::ZERO, DVec3::NEG_Y, &table()), start);
            }
            let rest = Predictor::Rest.predict(&start, Ticks::ZERO, DVec3::NEG_Y, &table());
            prop_assert_eq!(rest, start.stilled());
        }
    }
}
