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
/// Tolerances up to which it surely is none, though turns of two strides do not quite add up.
const SMOOTH: f64 = 0.5 * JUMP;
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
    jumped: bool,
}

impl<'s> RecentMotion<'s> {
    pub(super) fn new(context: &'s Context<'s>, subject: &'s Subject<'s>, units: &Units) -> Self {
        let apart_from = |past: &BodyState| apart(&subject.truth.pose(), &observed_pose(past));
        let displaced = subject.past.map(|past| past.map(apart_from));
        let since = SinceJump::new(subject, displaced, units);
        let step_s = context.tracks.integrator().rate.step().seconds();
        let evenly = |strides: f64| {
            let twist = subject.truth.twist();
            let seconds = step_s * f64::from(subject.stride.count()) * strides;
            Errors::of([twist.linear, twist.angular]) * seconds
        };
        let [last, both] = displaced;
        let last = since.past[0].and(last);
        let both = since.past[1].and(both);
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
        let (subject, slack) = (self.subject, self.context.slack);
        if has_nearly(subject, velocities, units, slack) {
            return true;
        }
        let stride = 1.0 / f64::from(subject.stride.count());
        let shown = Errors::of([velocities.linear, velocities.angular]) * units.moving;
        let own = subject.each_stride(units);
        // Shares include the slack, but what is shown does not.
        let within = if self.since.jumped {
            AFTER_JUMP / slack
        } else {
            let before =
                subject.past[0].map(|past| each_stride(&observed_twist(past), subject, units));
            let reach = units.share(&own) + units.share(&before.unwrap_or(own));
            ODD_VELOCITY / slack + ODD_SPEEDS * reach * stride
        };
        let is_near = |moved: Errors| units.share(&(shown - moved)) <= within;
        let [last, both] = self
            .moved
            .map(|moved| moved * (units.still * f64x2::splat(stride)));
        is_near(own * stride)
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
    /// `displaced`: the displacements since the observed states one and two strides before.
    fn new(subject: &Subject<'s>, displaced: [Option<Errors>; 2], units: &Units) -> Self {
        let (Some(one), Some(moved)) = (subject.past[0], displaced[0]) else {
            return Self::never(subject);
        };
        let middle = observed_twist(one);
        let last = moved * units.still;
        let jumps = jumps(last, [&middle, &subject.truth.twist()], subject, units);
        let Some((two, both)) = subject.past[1].zip(displaced[1]) else {
            let past = if jumps { [None; 2] } else { *subject.past };
            let jumped = jumps;
            return Self { past, jumped };
        };
        let first = observed_twist(two);
        // The turns of two strides add up nearly, which shows that nothing jumped; all else is compared as it was.
        let is_smooth = units
            .share(&(both * units.still - last - each_stride(&first, subject, units)))
            <= SMOOTH;
        if !jumps && is_smooth {
            return Self::never(subject);
        }
        let before = apart(&observed_pose(one), &observed_pose(two)) * units.still;
        let jumped = self::jumps(before, [&first, &middle], subject, units);
        // A body may move steadily whose engine reports no velocities.
        if !jumps && !jumped || units.share(&(last - before)) <= JUMP {
            return Self::never(subject);
        }
        Self {
            past: if jumps { [None; 2] } else { [Some(one), None] },
            jumped: true,
        }
    }

    /// The past of a body that did not jump.
    const fn never(subject: &Subject<'s>) -> Self {
        Self {
            past: *subject.past,
            jumped: false,
        }
    }
}

/// True if the velocities before and after a displacement in a stride do not explain it.
fn jumps(
    moved: Errors,
    [before, after]: [&Twist; 2],
    subject: &Subject<'_>,
    units: &Units,
) -> bool {
    let before = each_stride(before, subject, units);
    // A push takes no more off than nothing would.
    units.share(&(moved - before)) > JUMP
        && units.share(&unexplained(
            moved,
            [before, each_stride(after, subject, units)],
        )) > JUMP
}

/// Velocities over a stride, as shares of the tolerance.
fn each_stride(twist: &Twist, subject: &Subject<'_>, units: &Units) -> Errors {
    let ticks = f64::from(subject.stride.count());
    Errors::of([twist.linear, twist.angular]) * (units.moving * f64x2::splat(ticks))
}

/// True if velocities are so near to those of a body that it may be shown with them whatever happened before.
fn has_nearly(subject: &Subject<'_>, velocities: &Twist, units: &Units, slack: f64) -> bool {
    let own = subject.truth.twist();
    let off = Errors::of([
        velocities.linear - own.linear,
        velocities.angular - own.angular,
    ]);
    units.share(&(off * units.moving)) <= AFTER_JUMP / slack
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
    /// Its velocities over a stride, as shares of the tolerance.
    fn each_stride(&self, units: &Units) -> Errors {
        each_stride(&self.truth.twist(), self, units)
    }

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
