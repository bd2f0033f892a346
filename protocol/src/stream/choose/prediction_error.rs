//! How a body strays from a predictor, judged by its last two strides.
//!
//! Laws that move a body differ by what pulls at it alone, and turn it alike: what none pulls is reckoned once for all.

use glam::DVec3;
use rhumb_reckoning::{Motion, Predictor, Ticks, Twist};

use super::{Chooser, Subject, apart};

/// How a body strays from a predictor, by ticks: α·h + β·h², of position (m) and of turn (rad).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PredictionError {
    pub(super) linear: [DVec3; 2],
    pub(super) angular: [DVec3; 2],
}

impl PredictionError {
    /// By strides, from how far it diverged in one and in two.
    fn moving(one: [DVec3; 2], two: [DVec3; 2]) -> Self {
        let fit = |f1: DVec3, f2: DVec3| {
            let square = (f2 - f1 * 2.0) * 0.5;
            [f1 - square, square]
        };
        Self {
            linear: fit(one[0], two[0]),
            angular: fit(one[1], two[1]),
        }
    }

    /// By strides, of a body that is said to be still, from how far it moved in its last one and in its last two.
    pub(super) fn still(one: [DVec3; 2], two: [DVec3; 2]) -> Self {
        let fit = |f1: DVec3, f2: DVec3| {
            let square = (f1 * 2.0 - f2) * 0.5;
            [f1 + square, square]
        };
        Self {
            linear: fit(one[0], two[0]),
            angular: fit(one[1], two[1]),
        }
    }

    /// By ticks what is by strides.
    pub(super) fn by_ticks(self, stride: Ticks) -> Self {
        let ticks = f64::from(stride.count());
        let by_ticks = |[rate, square]: [DVec3; 2]| [rate / ticks, square / (ticks * ticks)];
        Self {
            linear: by_ticks(self.linear),
            angular: by_ticks(self.angular),
        }
    }
}

/// Where a body would be now that nothing pulled at in its last stride, and in its last two; none where it was not seen then.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnforcedMotion {
    now: DVec3,
    stride: Ticks,
    mode_candidates: [Option<UnforcedSample>; 2],
}

#[derive(Clone, Copy, Debug)]
struct UnforcedSample {
    position: DVec3,
    /// How far it is turned from there, rad.
    turned: DVec3,
    /// The share of what pulls, s².
    fall: f64,
}

impl UnforcedMotion {
    /// How the last two strides diverged from a predictor by which this pulls at the body, m/s².
    #[inline]
    pub(super) fn prediction_error(&self, pull: Option<DVec3>) -> PredictionError {
        let diverged = |unforced_sample: &UnforcedSample| {
            let expected = match pull {
                None => unforced_sample.position,
                Some(pull) => unforced_sample.position + pull * unforced_sample.fall,
            };
            [self.now - expected, unforced_sample.turned]
        };
        let by_strides = match &self.mode_candidates {
            [Some(one), Some(two)] => PredictionError::moving(diverged(one), diverged(two)),
            [Some(one), None] => {
                let one = diverged(one);
                PredictionError::moving(one, one.map(|by| by * 4.0))
            }
            [None, _] => return PredictionError::default(),
        };
        by_strides.by_ticks(self.stride)
    }
}

impl Chooser<'_> {
    /// How far a body moved in its last two strides.
    pub(super) fn rest_prediction_error(&self, subject: &Subject<'_>) -> PredictionError {
        let now = &subject.truth;
        let Twist { linear, angular } = now.twist();
        let step = self.tracks.integrator().rate.step().seconds();
        let steady = |ticks: f64| [linear * (ticks * step), angular * (ticks * step)];
        let moved = |past: &Option<Motion>, ticks: f64| match past {
            Some(past) => apart(&now.pose(), &past.pose()),
            None => steady(ticks),
        };
        let ([one, two], stride) = (&subject.past, subject.stride);
        let ticks = f64::from(stride.count());
        PredictionError::still(moved(one, ticks), moved(two, 2.0 * ticks)).by_ticks(stride)
    }

    /// How the last two strides would have been without a pull, by a predictor that does not fall.
    pub(super) fn unforced(&self, subject: &Subject<'_>, predictor: Predictor) -> UnforcedMotion {
        let (now, stride) = (subject.truth.pose(), subject.stride);
        let unforced_sample = |i: usize| {
            let (start, strides) = (subject.past[i].as_ref()?, i as u32 + 1);
            let (slot, ticks) = (subject.slot, Ticks::new(strides * stride.count()));
            let (expected, fall) = self.tracks.continued(slot, predictor, start, ticks);
            let [_, turned] = apart(&now, &expected.pose());
            Some(UnforcedSample {
                position: expected.pose().position,
                turned,
                fall,
            })
        };
        UnforcedMotion {
            now: now.position,
            stride,
            mode_candidates: [unforced_sample(0), unforced_sample(1)],
        }
    }
}
