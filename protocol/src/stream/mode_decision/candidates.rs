//! Stage one: the prediction modes that apply, each with its error forecast.
//!
//! The modes are rest, uniform, falling and accelerated in the world, and attached to another body. The moving modes
//! differ only by their acceleration, so that they share one unaccelerated forecast.

use glam::DVec3;
use rhumb_reckoning::{
    ConstantAcceleration, Motion, Pose, Predictor, Ticks, attached_motion, relative_to,
};

use super::acceleration::{ACCELERATIONS, accelerations};
use super::errors::{Errors, Units, apart, observed_pose, observed_twist};
use super::forecast::{ErrorForecast, Known, ParentPull};
use super::subject::{Context, Parent, Subject, share};
use crate::packet::{Age, PredictionMode};

/// Number of candidate modes: rest, uniform, falling, attached, accelerated.
const MODES: usize = 4 + ACCELERATIONS;
/// Mode number of rest.
pub(super) const REST: usize = 0;
/// Mode number of attached.
pub(super) const ATTACHED: usize = 3;
/// Ticks after which the expected errors of the modes are compared.
const COMPARED_TICKS: f64 = 3.0;
/// Greatest expected duration of an acceleration, in ticks.
const ACCELERATION_LASTS: f64 = 16.0;
/// Share of the parent's tolerance up to which its prediction stands for its pose. Beyond, an update of it is due soon.
const PARENT_SHARE: f64 = 0.6;

/// A prediction mode and the prediction that it corrects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<'a> {
    pub(super) mode: PredictionMode,
    pub(super) predictor: Predictor,
    /// The body that defines the frame of reference; `None` for the world.
    pub(super) parent: Option<&'a Parent<'a>>,
    /// The predicted motion in this frame.
    pub(super) motion: &'a Motion,
}

impl Prediction<'_> {
    pub(super) fn moves(&self) -> bool {
        self.predictor != Predictor::Rest
    }

    /// A pose of the frame in the world, as a subscriber computes it.
    pub(super) fn in_world(&self, pose: &Pose) -> Pose {
        match self.parent {
            None => *pose,
            Some(parent) => attached_motion(parent.predicted_motion, pose).pose(),
        }
    }
}

/// The attached mode.
#[derive(Debug)]
struct Attached<'a, const N: usize> {
    mode: PredictionMode,
    parent: &'a Parent<'a>,
    /// The predicted motion in the frame of the parent.
    predicted: Motion,
    forecast: Forecast<N>,
}

/// Inputs of one body's prediction modes.
#[derive(Debug)]
pub(super) struct Candidates<'a, const N: usize> {
    subject: &'a Subject<'a>,
    units: Units,
    /// Age of the track of the present parent.
    parent_age: Option<Age>,
    /// True if the parent is removed; the body then needs a keyframe.
    pub(super) orphaned: bool,
    rest: Option<Forecast<N>>,
    attached: Option<Attached<'a, N>>,
    floating: Predictor,
    falling: Predictor,
    unaccelerated: Forecast<N>,
    falls: Falls<N>,
    /// Difference of the true and the predicted velocities, per tick.
    pub(super) velocity: Errors,
    gravity: Option<DVec3>,
    accelerations: [Option<ConstantAcceleration>; ACCELERATIONS],
}

/// Error forecast of a mode without acceleration.
#[derive(Clone, Copy, Debug)]
struct Forecast<const N: usize> {
    known: Known<N>,
    slope: Errors,
    curve: Errors,
}

/// Displacement by an acceleration of 1 m/s², in metres: at each known tick, in the slope and in the curve.
#[derive(Clone, Copy, Debug)]
struct Falls<const N: usize> {
    known: [f64; N],
    slope: f64,
    curve: f64,
}

/// Growth of an error: per tick, and per tick squared.
#[derive(Clone, Copy, Debug)]
struct Growth {
    slope: [DVec3; 2],
    curve: [DVec3; 2],
}

impl Growth {
    /// Growth from the errors one and two strides after an exact prediction.
    fn of_errors([one, two]: [[DVec3; 2]; 2], stride: f64) -> Self {
        Self::of(one, two, stride, 0.5)
    }

    /// Growth from the displacements of a body in its last stride and in its last two.
    fn of_moves([one, two]: [[DVec3; 2]; 2], stride: f64) -> Self {
        Self::of(one, two, stride, -0.5)
    }

    fn of(one: [DVec3; 2], two: [DVec3; 2], stride: f64, bend: f64) -> Self {
        let (slope, curve) = (0.5 / stride, bend / (stride * stride));
        Self {
            slope: [
                (one[0] * 4.0 - two[0]) * slope,
                (one[1] * 4.0 - two[1]) * slope,
            ],
            curve: [
                (two[0] - one[0] * 2.0) * curve,
                (two[1] - one[1] * 2.0) * curve,
            ],
        }
    }
}

impl<'a, const N: usize> Candidates<'a, N> {
    pub(super) fn new(context: &Context<'_>, subject: &'a Subject<'a>, units: &Units) -> Self {
        let now = subject.track;
        let above = context.tracks.parent(now);
        let is_torque_free = subject.slot.is_torque_free() && context.features.torque_free;
        let (floating, falling) = if is_torque_free {
            (Predictor::TorqueFree, Predictor::BallisticTorqueFree)
        } else {
            (Predictor::Uniform, Predictor::Ballistic)
        };
        let gravity = context.tracks.gravity(subject.slot, subject.tick);
        let reach = 1.0 / units.still.to_array()[0];
        let parent = subject
            .parent
            .as_ref()
            .filter(|_| context.features.attached);
        let step_s = context.tracks.integrator().rate.step().seconds();
        let sources = Sources::<N> {
            context,
            subject,
            units,
            moved: [moved(subject, 1, step_s), moved(subject, 2, step_s)],
        };
        let apart = apart(&subject.truth.pose(), &subject.predicted_motion.pose());
        let (twist, other) = (subject.truth.twist(), subject.predicted_motion.twist());
        let velocity = Errors::of(
            [twist.linear - other.linear, twist.angular - other.angular],
            units.moving,
        );
        let (unaccelerated, falls) = sources.unaccelerated(floating, apart, &velocity);
        let rests = now.parent.is_none() && now.predictor == Predictor::Rest;
        Self {
            subject,
            units: *units,
            parent_age: above.and_then(|(_, slot)| context.tracks.age(&slot.track(), subject.tick)),
            orphaned: now.parent.is_some() && above.is_none(),
            rest: if context.features.resting && (N > 1 || rests || !sources.is_fast()) {
                Some(sources.rest(apart))
            } else {
                None
            },
            attached: parent.and_then(|parent| sources.attached(parent)),
            floating,
            falling,
            unaccelerated,
            falls,
            velocity,
            gravity: Some(gravity).filter(|by| context.features.ballistic && *by != DVec3::ZERO),
            accelerations: accelerations(context, subject, reach, gravity),
        }
    }

    /// The numbers of all modes.
    pub(super) fn modes(&self) -> impl Iterator<Item = usize> {
        let numbers = if self.orphaned { 0 } else { MODES };
        0..numbers
    }

    /// The error of the uncorrected prediction in the world.
    pub(super) fn error(&self) -> &Errors {
        &self.unaccelerated.known.errors()[0]
    }

    /// The error of the uncorrected prediction in the frame of the parent; `None` if the body cannot be attached.
    pub(super) fn attached_error(&self) -> Option<&Errors> {
        Some(&self.attached.as_ref()?.forecast.known.errors()[0])
    }

    /// The moving mode that is the track's own.
    pub(super) fn own_moving(&self) -> Option<usize> {
        let now = self.subject.track;
        match now.predictor {
            _ if now.parent.is_some() => None,
            predictor if predictor == self.floating => Some(1),
            predictor if predictor == self.falling => Some(2),
            // The track's own acceleration is the first of them.
            Predictor::Accelerated(_) => Some(4),
            _ => None,
        }
    }

    /// The moving mode with the least recent prediction error.
    pub(super) fn steadiest(&self) -> Option<usize> {
        let mut least = (None, f64::INFINITY);
        let [own, observed] = self.accelerations.map(|it| it.map(|it| it.acceleration()));
        let moving = [
            (1, Some(DVec3::ZERO)),
            (2, self.gravity),
            (4, own),
            (5, observed),
        ];
        for (number, acceleration) in moving {
            let Some(acceleration) = acceleration else {
                continue;
            };
            let pull = Errors::of_position(acceleration, self.units.still);
            let (free, falls) = (&self.unaccelerated, &self.falls);
            let slope = free.slope - self.velocity - pull * falls.slope;
            let share = self.expected_share(&slope, &(free.curve - pull * falls.curve));
            if share < least.1 {
                least = (Some(number), share);
            }
        }
        least.0
    }

    /// The share of the tolerance that an error of this growth takes after [`COMPARED_TICKS`].
    fn expected_share(&self, slope: &Errors, curve: &Errors) -> f64 {
        let errors = *slope * COMPARED_TICKS + *curve * (COMPARED_TICKS * COMPARED_TICKS);
        self.units.share(&errors)
    }

    /// The prediction of a mode; `None` if the mode does not apply.
    pub(super) fn prediction(&self, number: usize) -> Option<Prediction<'_>> {
        let predictor = match number {
            REST => Predictor::Rest,
            1 => self.floating,
            2 => self.falling,
            ATTACHED => {
                let attached = self.attached.as_ref()?;
                return Some(Prediction {
                    mode: attached.mode,
                    predictor: Predictor::Rest,
                    parent: Some(attached.parent),
                    motion: &attached.predicted,
                });
            }
            _ => Predictor::Accelerated(self.accelerations[number - 4]?),
        };
        let now = self.subject.track;
        let same = now.parent.is_none() && now.predictor == predictor;
        Some(Prediction {
            mode: if same {
                PredictionMode::Same
            } else {
                PredictionMode::World {
                    predictor,
                    parent_age: self.parent_age,
                }
            },
            predictor,
            parent: None,
            motion: self.subject.predicted_motion,
        })
    }

    /// The error forecast of a mode; `None` if the mode does not apply.
    pub(super) fn error_forecast(&self, number: usize) -> Option<ErrorForecast<'_>> {
        let steady = f64::INFINITY;
        Some(match number {
            REST => self.forecast(self.rest.as_ref()?, steady),
            1 => self.forecast(&self.unaccelerated, steady),
            2 => self.accelerated(self.gravity?, steady),
            ATTACHED => self.forecast(&self.attached.as_ref()?.forecast, steady),
            _ => {
                let acceleration = self.accelerations[number - 4]?.acceleration();
                self.accelerated(acceleration, ACCELERATION_LASTS)
            }
        })
    }

    fn forecast<'c>(&self, of: &'c Forecast<N>, lasts: f64) -> ErrorForecast<'c> {
        let known = of.known.errors();
        let last = known.len() - 1;
        ErrorForecast {
            known,
            pull: None,
            slope: of.slope,
            curve: of.curve,
            ends: self.subject.ends && last == self.subject.ahead.len(),
            lasts,
        }
    }

    /// The forecast of a moving mode with this acceleration, m/s².
    fn accelerated(&self, acceleration: DVec3, lasts: f64) -> ErrorForecast<'_> {
        let each = Errors::of_position(acceleration, self.units.still);
        let (free, falls) = (self.forecast(&self.unaccelerated, lasts), &self.falls);
        ErrorForecast {
            pull: Some(ParentPull {
                each,
                falls: &falls.known,
            }),
            slope: free.slope - each * falls.slope,
            curve: free.curve - each * falls.curve,
            ..free
        }
    }
}

/// Inputs of one body's forecasts.
#[derive(Clone, Copy, Debug)]
struct Sources<'s, 'a, const N: usize> {
    context: &'s Context<'s>,
    subject: &'a Subject<'a>,
    units: &'s Units,
    /// Displacement of the body in its last stride and in its last two.
    moved: [[DVec3; 2]; 2],
}

impl<'a, const N: usize> Sources<'_, 'a, N> {
    /// The forecast from the errors at the published tick and at the known ticks after it.
    fn forecast(
        &self,
        now: [DVec3; 2],
        error: impl Fn(usize, &Motion) -> Option<[DVec3; 2]>,
        past_growth: impl FnOnce() -> Growth,
    ) -> Forecast<N> {
        let of = |errors| Errors::of(errors, self.units.still);
        let subject = self.subject;
        let mut known = Known::new(of(now));
        for (tick, truth) in (1..N).zip(subject.ahead) {
            let Some(error) = error(tick, truth) else {
                break;
            };
            known.push(of(error));
        }
        let (slope, curve) = match known.errors() {
            [.., before, last] => (*last - *before, Errors::ZERO),
            _ => {
                let growth = past_growth();
                (of(growth.slope), of(growth.curve))
            }
        };
        Forecast {
            known,
            slope,
            curve,
        }
    }

    /// True if the body moves by the tolerance or more in each tick, so that rest cannot hold.
    fn is_fast(&self) -> bool {
        let moved = Errors::of(self.moved[0], self.units.still);
        self.units.share(&moved) > f64::from(self.subject.stride.count())
    }

    /// The forecast of a body that rests at its predicted pose.
    fn rest(&self, now: [DVec3; 2]) -> Forecast<N> {
        let predicted = self.subject.predicted_motion.pose();
        self.forecast(
            now,
            |_, truth| Some(apart(&truth.pose(), &predicted)),
            || Growth::of_moves(self.moved, f64::from(self.subject.stride.count())),
        )
    }

    /// The forecast of a mode without acceleration, and the displacements that an acceleration adds.
    fn unaccelerated(
        &self,
        predictor: Predictor,
        now: [DVec3; 2],
        velocity: &Errors,
    ) -> (Forecast<N>, Falls<N>) {
        let (subject, tracks) = (self.subject, self.context.tracks);
        let slot = subject.slot;
        let mut motion = *subject.predicted_motion;
        let mut expected = [motion.pose(); N];
        let mut falls = [0.0; N];
        for tick in 1..=subject.ahead.len().min(N - 1) {
            motion = tracks.continued(slot, predictor, &motion, Ticks::new(1));
            expected[tick] = motion.pose();
            falls[tick] = tracks.unforced(slot, Ticks::new(tick as u32)).fall;
        }
        let (past_errors, fallen) = self.past_errors(predictor);
        let stride = f64::from(subject.stride.count());
        let mut forecast = self.forecast(
            now,
            |tick, truth| Some(apart(&truth.pose(), &expected[tick])),
            || Growth::of_errors(past_errors, stride),
        );
        let last = forecast.known.errors().len() - 1;
        let mut falls = Falls {
            known: falls,
            slope: fallen[0] * (2.0 / stride) - fallen[1] * (0.5 / stride),
            curve: (fallen[1] - fallen[0] * 2.0) * (0.5 / (stride * stride)),
        };
        if last == 0 {
            forecast.slope = forecast.slope + *velocity;
        } else {
            falls.slope = falls.known[last] - falls.known[last - 1];
            falls.curve = 0.0;
        }
        (forecast, falls)
    }

    /// Errors of an unaccelerated mode over the last stride and the last two, and the displacement that an acceleration
    /// of 1 m/s² adds to them.
    fn past_errors(&self, predictor: Predictor) -> ([[DVec3; 2]; 2], [f64; 2]) {
        let (subject, tracks) = (self.subject, self.context.tracks);
        let prediction_error = |strides: usize| {
            let past = subject.past[strides - 1].as_ref()?;
            let ticks = Ticks::new(strides as u32 * subject.stride.count());
            let unforced = tracks.unforced(subject.slot, ticks);
            if predictor.is_torque_free() {
                let expected = tracks.continued(subject.slot, predictor, &past.motion(), ticks);
                return Some((
                    apart(&subject.truth.pose(), &expected.pose()),
                    unforced.fall,
                ));
            }
            let (twist, [moved, turned]) = (observed_twist(past), self.moved[strides - 1]);
            let diverged = [
                moved - twist.linear * unforced.reach,
                turned - twist.angular * unforced.turn,
            ];
            Some((diverged, unforced.fall))
        };
        let Some((one, fall)) = prediction_error(1) else {
            return ([[DVec3::ZERO; 2]; 2], [0.0; 2]);
        };
        let (two, fallen) =
            prediction_error(2).unwrap_or(([one[0] * 4.0, one[1] * 4.0], fall * 4.0));
        ([one, two], [fall, fallen])
    }

    /// The attached mode; `None` if it does not apply.
    fn attached(&self, parent: &'a Parent<'a>) -> Option<Attached<'a, N>> {
        let (subject, tracks) = (self.subject, self.context.tracks);
        let track = subject.track;
        let above = parent.slot.track();
        let is_attached = track.parent == Some(parent.slot.id(parent.index));
        let may_be =
            track.parent.is_none() && above.parent.is_none() && parent.index != subject.index;
        if !is_attached && !may_be {
            return None;
        }
        let (own, other) = (subject.truth.twist(), parent.truth.twist());
        let arm = subject.truth.pose().position - parent.truth.pose().position;
        let drift = own.linear - other.linear - other.angular.cross(arm);
        let drift = Errors::of_position(drift, self.units.moving);
        if N == 1 && !is_attached && self.units.share(&drift) > 1.0 {
            return None;
        }
        // A body without past observations has no evidence of being attached.
        let past = parent.past?;
        let now = relative_to(&parent.truth.pose(), &subject.truth.pose());
        let moved = |stride: usize| {
            let (own, of) = (subject.past[stride].as_ref()?, past[stride].as_ref()?);
            let past = relative_to(&observed_pose(of), &observed_pose(own));
            Some(apart(&now.pose(), &past.pose()))
        };
        let one = moved(0)?;
        let stride = f64::from(subject.stride.count());
        let two = moved(1).unwrap_or([one[0] * 2.0, one[1] * 2.0]);
        let by = parent.predicted_motion.pose();
        let truth = relative_to(&by, &subject.truth.pose());
        let predicted = if is_attached {
            *subject.framed
        } else {
            relative_to(&by, &subject.predicted_motion.pose())
        };
        let mode = if is_attached {
            PredictionMode::Same
        } else {
            PredictionMode::Attached {
                parent: parent.index,
                parent_age: tracks.age(&above, subject.tick)?,
            }
        };
        let error = |tick: usize, truth: &Motion| {
            let by = expected_parent_pose(self.context, subject, parent, tick)?;
            let relative = relative_to(&by, &truth.pose());
            Some(apart(&relative.pose(), &predicted.pose()))
        };
        let now = apart(&truth.pose(), &predicted.pose());
        let forecast = self.forecast(now, error, || Growth::of_moves([one, two], stride));
        Some(Attached {
            mode,
            parent,
            predicted,
            forecast,
        })
    }
}

/// Displacement of a body in its last strides, from its velocities if it has no past observation.
fn moved(subject: &Subject<'_>, strides: usize, step_s: f64) -> [DVec3; 2] {
    match &subject.past[strides - 1] {
        Some(past) => apart(&subject.truth.pose(), &observed_pose(past)),
        None => {
            let twist = subject.truth.twist();
            let seconds = step_s * f64::from(subject.stride.count()) * strides as f64;
            [twist.linear * seconds, twist.angular * seconds]
        }
    }
}

/// Expected pose of a parent after `ticks`: the predicted one, or the true one if an update of it is due before.
fn expected_parent_pose(
    context: &Context<'_>,
    subject: &Subject<'_>,
    parent: &Parent<'_>,
    ticks: usize,
) -> Option<Pose> {
    let truth = parent.ahead.get(ticks - 1)?.pose();
    let (tracks, slot) = (context.tracks, parent.slot);
    let tick = subject.tick + Ticks::new(ticks as u32);
    let predicted_motion = tracks.framed((parent.index, slot), &slot.track(), tick);
    let used = share(
        &truth,
        &predicted_motion.pose(),
        tracks.tolerance_of(slot),
        tracks.radius(slot),
    );
    Some(if used <= PARENT_SHARE {
        predicted_motion.pose()
    } else {
        truth
    })
}
