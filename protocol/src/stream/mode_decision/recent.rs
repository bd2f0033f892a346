//! One body as the mode decision sees it: its stream, and its recent motion.
//!
//! In metres and radians, whatever the tolerance. Contains data alone, no decision. Without past observations a body
//! counts as moving evenly. A body that jumps, as by a command that places it, has no past before the jump.

use glam::DVec3;
use rhumb_reckoning::{
    BodyState, Divergence, Metres, Motion, Pose, Predictor, Tick, Ticks, Tolerance, Track, Twist,
};
use wide::f64x2;

use super::forecast::{Errors, Units, apart, observed_pose, observed_twist};
use crate::stream::Features;
use crate::stream::tracks::{Slot, Tracks};

/// Tolerances by which a displacement must differ from what the velocities explain to be a jump. A view has the same
/// limit.
const JUMP: f64 = 3.0;
/// Greatest error of the velocities that a correction implies after a jump: over a tick, as a share of the tolerance.
const AFTER_JUMP: f64 = 1.0;
/// The same for other bodies, and what it grows by with their speeds: a body that is hit has implied velocities of
/// their size, and only one whose correction had to wait has greater ones.
const ODD_VELOCITY: f64 = 8.0;
const ODD_SPEEDS: f64 = 2.0;

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
    since: SinceJump<'s>,
}

/// The past of a body since it jumped, if it did so in its last two strides.
#[derive(Clone, Copy, Debug)]
struct SinceJump<'s> {
    /// The observed states one and two strides before, none before the jump.
    past: [Option<&'s BodyState>; 2],
    /// The displacement since the state one stride before, whether it jumped or not.
    moved: Option<Errors>,
    /// The reach of its velocities in a stride, before and after it, as a share of the tolerance.
    reach: f64,
    jumped: bool,
}

impl<'s> RecentMotion<'s> {
    pub(super) fn new(context: &'s Context<'s>, subject: &'s Subject<'s>, units: &Units) -> Self {
        let since = SinceJump::new(subject, units);
        let step_s = context.tracks.integrator().rate.step().seconds();
        let evenly = |strides: f64| {
            let twist = subject.truth.twist();
            let seconds = step_s * f64::from(subject.stride.count()) * strides;
            Errors::of([twist.linear, twist.angular]) * seconds
        };
        let last = since.past[0].and(since.moved);
        let both = since.past[1].map(|past| apart(&subject.truth.pose(), &observed_pose(past)));
        let moved = [
            last.unwrap_or_else(|| evenly(1.0)),
            both.unwrap_or_else(|| evenly(2.0)),
        ];
        Self {
            context,
            subject,
            moved,
            since,
        }
    }

    /// True if the body may be shown with these velocities until the next tick: they differ little from its own, or it
    /// was displaced by them in both strides. A correction implies velocities; those of a jump lead beyond both places.
    pub(super) fn may_have(&self, velocities: &Twist, units: &Units) -> bool {
        let each_tick = |twist: Twist| Errors::of([twist.linear, twist.angular]) * units.moving;
        let (stride, shown) = (
            1.0 / f64::from(self.subject.stride.count()),
            each_tick(*velocities),
        );
        // Shares include the slack, but what is shown does not.
        let within = if self.since.jumped {
            AFTER_JUMP / self.context.slack
        } else {
            ODD_VELOCITY / self.context.slack + ODD_SPEEDS * self.since.reach * stride
        };
        let is_near = |moved: Errors| units.share(&(shown - moved)) <= within;
        let [last, both] = self
            .moved
            .map(|moved| moved * (units.still * f64x2::splat(stride)));
        is_near(each_tick(self.subject.truth.twist()))
            || self.since.past[1].is_some() && is_near(last) && is_near(both - last)
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
            let past = self.since.past[strides - 1]?;
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

impl<'s> SinceJump<'s> {
    fn new(subject: &Subject<'s>, units: &Units) -> Self {
        let ticks = f64::from(subject.stride.count());
        let each_stride =
            |twist: &Twist| Errors::of([twist.linear, twist.angular]) * units.moving * ticks;
        let now = each_stride(&subject.truth.twist());
        let Some(one) = subject.past[0] else {
            return Self {
                past: *subject.past,
                moved: None,
                reach: units.share(&now) * 2.0,
                jumped: false,
            };
        };
        let (pose, middle) = (observed_pose(one), each_stride(&observed_twist(one)));
        let moved = apart(&subject.truth.pose(), &pose);
        let last = moved * units.still;
        let jumps = units.share(&unexplained(last, [middle, now])) > JUMP;
        let (mut jumped, mut is_steady) = (false, false);
        if let Some(two) = subject.past[1] {
            let before = apart(&pose, &observed_pose(two)) * units.still;
            let first = each_stride(&observed_twist(two));
            jumped = units.share(&unexplained(before, [first, middle])) > JUMP;
            // A body may move steadily whose engine reports no velocities.
            is_steady = units.share(&(last - before)) <= JUMP;
        }
        let past = match (jumps, jumped) {
            _ if is_steady => *subject.past,
            (true, _) => [None; 2],
            (_, true) => [Some(one), None],
            _ => *subject.past,
        };
        Self {
            past,
            moved: Some(moved),
            reach: units.share(&now) + units.share(&middle),
            jumped: (jumps || jumped) && !is_steady,
        }
    }
}

/// The rest of a displacement in a stride, where the velocities lead `before` and `after` something that happened
/// within it: a push explains a part of their difference.
fn unexplained(moved: Errors, [before, after]: [Errors; 2]) -> Errors {
    let (left, push) = (moved - before, after - before);
    let part = left.dot(&push) / push.dot(&push).fast_max(f64x2::splat(f64::MIN_POSITIVE));
    left - push * part.fast_max(f64x2::ZERO).fast_min(f64x2::ONE)
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

/// A body that needs an update, with its observations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The track that no longer holds.
    pub(crate) track: &'a Track,
    /// The published tick.
    pub(crate) tick: Tick,
    /// The body's true motion at that tick.
    pub(crate) truth: &'a Motion,
    /// The body's predicted motion at that tick.
    pub(crate) predicted_motion: &'a Motion,
    /// The same in the frame of the track.
    pub(crate) framed: &'a Motion,
    /// The true linear velocities one and two ticks before, m/s.
    pub(crate) velocities: Option<[DVec3; 2]>,
    /// The observed states one and two strides before.
    pub(crate) past: &'a [Option<&'a BodyState>; 2],
    /// Ticks between two observations before the published tick.
    pub(crate) stride: Ticks,
    /// The true motions of the next ticks, as far as the lookahead reaches.
    pub(crate) ahead: &'a [Motion],
    /// True if the body has no observations after those.
    pub(crate) ends: bool,
    /// A body that this body may be attached to.
    pub(crate) parent: Option<Parent<'a>>,
}

impl Subject<'_> {
    /// Difference of the true and the predicted velocities, in m/s and rad/s.
    pub(super) fn velocity_error(&self) -> Errors {
        let (truth, predicted) = (self.truth.twist(), self.predicted_motion.twist());
        Errors::of([
            truth.linear - predicted.linear,
            truth.angular - predicted.angular,
        ])
    }
}

/// A possible parent, with its observations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parent<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The true motion at the published tick.
    pub(crate) truth: &'a Motion,
    /// The predicted motion in the frame of its track.
    pub(crate) predicted_motion: &'a Motion,
    /// The observed states one and two strides of the child before.
    pub(crate) past: Option<&'a [Option<BodyState>; 2]>,
    /// The true motions of the next ticks.
    pub(crate) ahead: &'a [Motion],
}

/// State of the publisher that a decision depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Context<'a> {
    pub(crate) tracks: &'a Tracks,
    pub(crate) features: Features,
    /// Factor on the tolerances in lifetime estimates: above one if the budget does not suffice, below one for parents.
    pub(crate) slack: f64,
}

/// Share of the tolerance that the difference of two poses of a body takes.
pub(crate) fn share(
    truth: &Pose,
    predicted_motion: &Pose,
    tolerance: Tolerance,
    radius: Metres,
) -> f64 {
    tolerance.share(&Divergence::between(truth, predicted_motion), radius)
}
