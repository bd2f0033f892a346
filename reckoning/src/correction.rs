//! Smooths a jump of a displayed body into a short glide.
//!
//! For display only, never normative. A correction is a function of time: it is the whole jump at its start and zero
//! after [`Correction::SPAN`]. Its velocity is the derivative of the displayed offset.

use glam::DVec3;

use crate::exact::turn_by;
use crate::motion::{Motion, Pose, Twist};
use crate::units::{Metres, Seconds};

/// Offset that is still to be taken off a displayed motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    start: Seconds,
    offset: DVec3,
    offset_velocity: DVec3,
    turn: DVec3,
}

impl Correction {
    /// Duration of a glide.
    pub const SPAN: Seconds = Seconds::new(0.1);
    /// A jump longer than this is shown at once: it is a teleport, not an error.
    pub const TELEPORT: Metres = Metres::new(2.0);

    /// A correction of zero.
    pub const NONE: Self = Self {
        start: Seconds::new(f64::NEG_INFINITY),
        offset: DVec3::ZERO,
        offset_velocity: DVec3::ZERO,
        turn: DVec3::ZERO,
    };

    /// The correction that leads from `shown` to `predicted_motion` from `now` on, without a jump in position or
    /// velocity.
    #[must_use]
    pub fn between(now: Seconds, shown: &Motion, predicted_motion: &Motion) -> Self {
        let offset = shown.pose().position - predicted_motion.pose().position;
        if offset.length() > Self::TELEPORT.metres() {
            return Self::NONE;
        }
        let quotient = shown.pose().rotation * predicted_motion.pose().rotation.conjugate();
        let quotient = if quotient.w < 0.0 {
            -quotient
        } else {
            quotient
        };
        Self {
            start: now,
            offset,
            offset_velocity: shown.twist().linear - predicted_motion.twist().linear,
            turn: quotient.to_scaled_axis(),
        }
    }

    /// The motion to display at `now`, where the prediction is `predicted_motion`.
    #[must_use]
    pub fn applied(&self, now: Seconds, predicted_motion: &Motion) -> Motion {
        let span = Self::SPAN.seconds();
        let s = (now.seconds() - self.start.seconds()) / span;
        // Written so that NaN counts as over.
        let under_way = (0.0..1.0).contains(&s);
        if !under_way {
            return *predicted_motion;
        }
        // Cubic Hermite from (offset, velocity) to (0, 0); `h` weighs the offset, `k` the velocity times the span.
        let h = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s);
        let k = s * (1.0 - s) * (1.0 - s);
        let dh = 6.0 * s * (s - 1.0) / span;
        let dk = (1.0 - s) * (1.0 - 3.0 * s);
        let (pose, twist) = (predicted_motion.pose(), predicted_motion.twist());
        let shown = Pose {
            position: pose.position + self.offset * h + self.offset_velocity * (k * span),
            rotation: (turn_by(self.turn * h) * pose.rotation).normalize(),
        };
        let moving = Twist {
            linear: twist.linear + self.offset * dh + self.offset_velocity * dk,
            angular: twist.angular + self.turn * dh,
        };
        Motion::new(shown, moving).unwrap_or(*predicted_motion)
    }

    /// True if the glide has ended.
    #[must_use]
    pub fn is_over(&self, now: Seconds) -> bool {
        let left = now.seconds() - self.start.seconds() < Self::SPAN.seconds();
        !left
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn motion() -> impl Strategy<Value = Motion> {
        let part = || proptest::array::uniform3(-0.5_f64..0.5).prop_map(DVec3::from_array);
        (part(), part(), part(), part()).prop_map(|(position, turn, linear, angular)| {
            let rotation = DQuat::from_scaled_axis(turn);
            Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap()
        })
    }

    proptest! {
        #[test]
        fn a_correction_starts_at_the_displayed_motion(shown in motion(), predicted_motion in motion()) {
            let now = Seconds::new(7.0);
            let first = Correction::between(now, &shown, &predicted_motion).applied(now, &predicted_motion);
            prop_assert!((first.pose().position - shown.pose().position).length() < 1e-9);
            prop_assert!((first.twist().linear - shown.twist().linear).length() < 1e-9);
            prop_assert!(first.pose().rotation.angle_between(shown.pose().rotation) < 1e-6);
        }

        #[test]
        fn a_correction_is_zero_after_its_span(shown in motion(), predicted_motion in motion()) {
            let correction = Correction::between(Seconds::new(7.0), &shown, &predicted_motion);
            let late = Seconds::new(7.0 + Correction::SPAN.seconds() + 1e-9);
            prop_assert_eq!(correction.applied(late, &predicted_motion), predicted_motion);
            prop_assert!(correction.is_over(Seconds::new(8.0)));
        }

        #[test]
        fn its_velocity_is_the_derivative_of_its_offset(
            shown in motion(), predicted_motion in motion(), s in 0.01_f64..0.09,
        ) {
            let still = predicted_motion.stilled();
            let correction = Correction::between(Seconds::new(0.0), &shown, &still);
            let step = 1e-6;
            let before = correction.applied(Seconds::new(s - step), &still).pose().position;
            let after = correction.applied(Seconds::new(s + step), &still).pose().position;
            let shown_velocity = correction.applied(Seconds::new(s), &still).twist().linear;
            prop_assert!(((after - before) / (2.0 * step) - shown_velocity).length() < 1e-4);
        }
    }

    #[test]
    fn a_teleport_does_not_glide() {
        let far = Pose {
            position: DVec3::X * 10.0,
            rotation: DQuat::IDENTITY,
        };
        let far = Motion::new(far, Twist::ZERO).unwrap();
        assert_eq!(
            Correction::between(Seconds::new(1.0), &far, &Motion::IDENTITY),
            Correction::NONE
        );
    }
}
