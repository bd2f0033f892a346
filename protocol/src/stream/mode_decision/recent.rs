//! The motion of a body in its last two strides, and how it left predictions.
//!
//! In metres and radians, whatever the tolerance. Without past observations a body counts as moving evenly.

use rhumb_reckoning::{Predictor, Ticks};

use super::errors::{Errors, apart, observed_pose, observed_twist};
use super::subject::{Context, Subject};

/// Growth of an error: per tick, and per tick squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Growth {
    pub(super) slope: Errors,
    pub(super) curve: Errors,
}

/// Growth of the displacement by an acceleration of 1 m/s²: metres per tick, and per tick squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct FallGrowth {
    pub(super) slope: f64,
    pub(super) curve: f64,
}

/// The displacements of a body in its last stride and in its last two.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecentMotion<'s> {
    context: &'s Context<'s>,
    pub(super) subject: &'s Subject<'s>,
    pub(super) moved: [Errors; 2],
}

impl<'s> RecentMotion<'s> {
    pub(super) fn new(context: &'s Context<'s>, subject: &'s Subject<'s>) -> Self {
        let step_s = context.tracks.integrator().rate.step().seconds();
        let moved = |strides: usize| match subject.past[strides - 1] {
            Some(past) => apart(&subject.truth.pose(), &observed_pose(past)),
            None => {
                let twist = subject.truth.twist();
                let seconds = step_s * f64::from(subject.stride.count()) * strides as f64;
                Errors::of([twist.linear, twist.angular]) * seconds
            }
        };
        Self {
            context,
            subject,
            moved: [moved(1), moved(2)],
        }
    }

    /// Growth of the error of a body that is predicted to rest.
    pub(super) fn of_rest(&self) -> Growth {
        growth_of_moves(self.moved, self.subject.stride)
    }

    /// Growth of the error of a prediction without acceleration, and of the displacement that an acceleration adds.
    pub(super) fn of_unaccelerated(&self, predictor: Predictor) -> (Growth, FallGrowth) {
        let ([one, two], [fall, fallen]) = self.past_errors(predictor);
        let stride = f64::from(self.subject.stride.count());
        let falls = FallGrowth {
            slope: fall * (2.0 / stride) - fallen * (0.5 / stride),
            curve: (fallen - fall * 2.0) * (0.5 / (stride * stride)),
        };
        (growth(one, two, self.subject.stride, 0.5), falls)
    }

    /// Errors of an exact prediction without acceleration over the last stride and the last two, and the displacement
    /// that an acceleration of 1 m/s² adds to them.
    fn past_errors(&self, predictor: Predictor) -> ([Errors; 2], [f64; 2]) {
        let (subject, tracks) = (self.subject, self.context.tracks);
        let prediction_error = |strides: usize| {
            let past = subject.past[strides - 1]?;
            let ticks = Ticks::new(strides as u32 * subject.stride.count());
            let unforced = tracks.unforced(subject.slot, ticks);
            if predictor.is_torque_free() {
                let expected = tracks.continued(subject.slot, predictor, &past.motion(), ticks);
                let diverged = apart(&subject.truth.pose(), &expected.pose());
                return Some((diverged, unforced.fall));
            }
            let twist = observed_twist(past);
            let [linear, angular] = [twist.linear * unforced.reach, twist.angular * unforced.turn];
            let diverged = self.moved[strides - 1] - Errors::of([linear, angular]);
            Some((diverged, unforced.fall))
        };
        let Some((one, fall)) = prediction_error(1) else {
            return ([Errors::ZERO; 2], [0.0; 2]);
        };
        let (two, fallen) = prediction_error(2).unwrap_or((one * 4.0, fall * 4.0));
        ([one, two], [fall, fallen])
    }
}

/// Growth from the displacements of a body in its last stride and in its last two.
pub(super) fn growth_of_moves([one, two]: [Errors; 2], stride: Ticks) -> Growth {
    growth(one, two, stride, -0.5)
}

fn growth(one: Errors, two: Errors, stride: Ticks, bend: f64) -> Growth {
    let stride = f64::from(stride.count());
    Growth {
        slope: (one * 4.0 - two) * (0.5 / stride),
        curve: (two - one * 2.0) * (bend / (stride * stride)),
    }
}
