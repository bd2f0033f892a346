//! Modes that apply to a body, their forecast, the price of a correction.
//!
//! The modes are rest, uniform, falling, accelerated and attached; each has a number. The moving modes differ only by
//! their acceleration, so that they share one unaccelerated forecast. An engine's velocities are exact, so that the
//! difference of two ticks gives the acceleration. An acceleration is steady if the tick before, or with lookahead the
//! next tick, has the same one.
//!
//! The coder's state is that at the start of a packet, because the packet's other updates are not known yet. A
//! correction that breaks the tolerance within the lookahead is priced together with the next correction.

use glam::DVec3;
use rhumb_reckoning::{
    ConstantAcceleration, Motion, Pose, Predictor, Residual, Ticks, VelocityResidual,
    attached_motion, relative_to,
};

use super::forecast::{
    Acceleration, Effect, ErrorForecast, Errors, Expectation, Known, Lifetime, SPAN, Units, apart,
    observed_pose,
};
use super::recent::{
    Context, FallGrowth, Growth, Parent, RecentMotion, Subject, growth_of_moves, share,
};
use crate::packet::{Age, CostModel, InitialCostModel, PredictionMode};
use crate::stream::Features;

/// Inputs of one body's prediction modes.
#[derive(Debug)]
pub(super) struct Candidates<'a> {
    subject: &'a Subject<'a>,
    units: Units,
    modes: WorldModes<'a>,
    rest: Option<Forecast>,
    attached: Option<(Attached<'a>, Forecast)>,
    unaccelerated: Forecast,
    falls: Falls,
}

/// Error forecast of a mode without acceleration.
#[derive(Clone, Copy, Debug)]
struct Forecast {
    known: Known,
    slope: Errors,
    curve: Errors,
}

/// Displacement by an acceleration of 1 m/s², in metres: at each known tick, and its growth beyond.
#[derive(Clone, Copy, Debug)]
struct Falls {
    known: [f64; SPAN],
    growth: FallGrowth,
}

impl<'a> Candidates<'a> {
    pub(super) fn new(context: &'a Context<'a>, recent: &RecentMotion<'a>, units: &Units) -> Self {
        let subject = recent.subject;
        let modes = WorldModes::new(context, subject, units);
        let now = apart(&subject.truth.pose(), &subject.predicted_motion.pose());
        let attached = Attached::new(context, subject).map(|attached| {
            let error = |tick: usize, truth: &Motion| attached.error(tick, truth);
            let forecast = Forecast::new(subject, units, attached.now, error, attached.growth);
            (attached, forecast)
        });
        let rest = context.features.resting.then(|| {
            let predicted = subject.predicted_motion.pose();
            let error = |_, truth: &Motion| Some(apart(&truth.pose(), &predicted));
            Forecast::new(subject, units, now, error, recent.of_rest())
        });
        let (unaccelerated, falls) =
            Forecast::unaccelerated(context, recent, units, modes.floating, now);
        Self {
            subject,
            units: *units,
            modes,
            rest,
            attached,
            unaccelerated,
            falls,
        }
    }

    /// The numbers of all modes.
    pub(super) fn modes(&self) -> impl Iterator<Item = usize> {
        let numbers = if self.modes.orphaned { 0 } else { MODES };
        0..numbers
    }

    /// The prediction of a mode; `None` if the mode does not apply.
    pub(super) fn prediction(&self, number: usize) -> Option<Prediction<'_>> {
        match number {
            ATTACHED => Some(self.attached.as_ref()?.0.prediction()),
            _ => self.modes.prediction(number),
        }
    }

    /// The error forecast of a mode; `None` if the mode does not apply.
    pub(super) fn error_forecast(&self, number: usize) -> Option<ErrorForecast<'_>> {
        let steady = f64::INFINITY;
        Some(match number {
            REST => self.forecast(self.rest.as_ref()?, steady),
            ATTACHED => self.forecast(&self.attached.as_ref()?.1, steady),
            FLOATING => self.forecast(&self.unaccelerated, steady),
            _ => {
                let (acceleration, lasts) = self.modes.acceleration(number)?;
                self.accelerated(acceleration, lasts)
            }
        })
    }

    fn forecast<'c>(&self, of: &'c Forecast, lasts: f64) -> ErrorForecast<'c> {
        let known = of.known.errors();
        let last = known.len() - 1;
        ErrorForecast {
            known,
            acceleration: None,
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
            acceleration: Some(Acceleration {
                each,
                falls: &falls.known,
            }),
            slope: free.slope - each * falls.growth.slope,
            curve: free.curve - each * falls.growth.curve,
            ..free
        }
    }
}

impl Forecast {
    /// The forecast from the errors at the published tick and at the known ticks after it, in metres and radians.
    ///
    /// `past_growth`: the growth if no tick after the published one is known.
    fn new(
        subject: &Subject<'_>,
        units: &Units,
        now: Errors,
        error: impl Fn(usize, &Motion) -> Option<Errors>,
        past_growth: Growth,
    ) -> Self {
        let mut known = Known::new(now * units.still);
        for (tick, truth) in (1..SPAN).zip(subject.ahead) {
            let Some(error) = error(tick, truth) else {
                break;
            };
            known.push(error * units.still);
        }
        let (slope, curve) = match known.errors() {
            [.., before, last] => (*last - *before, Errors::ZERO),
            _ => (
                past_growth.slope * units.still,
                past_growth.curve * units.still,
            ),
        };
        Self {
            known,
            slope,
            curve,
        }
    }

    /// The forecast of a mode without acceleration, and the displacements that an acceleration adds.
    fn unaccelerated(
        context: &Context<'_>,
        recent: &RecentMotion<'_>,
        units: &Units,
        predictor: Predictor,
        now: Errors,
    ) -> (Self, Falls) {
        let (subject, tracks) = (recent.subject, context.tracks);
        let slot = subject.slot;
        let mut motion = *subject.predicted_motion;
        let mut expected = [motion.pose(); SPAN];
        let mut falls = [0.0; SPAN];
        for tick in 1..=subject.ahead.len().min(SPAN - 1) {
            motion = tracks.continued(slot, predictor, &motion, Ticks::new(1));
            expected[tick] = motion.pose();
            falls[tick] = tracks.unforced(slot, Ticks::new(tick as u32)).fall;
        }
        let (past_growth, fall_growth) = recent.of_unaccelerated(predictor);
        let error = |tick: usize, truth: &Motion| Some(apart(&truth.pose(), &expected[tick]));
        let mut forecast = Self::new(subject, units, now, error, past_growth);
        let mut falls = Falls {
            known: falls,
            growth: fall_growth,
        };
        match forecast.known.errors().len() - 1 {
            0 => forecast.slope = forecast.slope + subject.velocity_error() * units.moving,
            last => {
                falls.growth = FallGrowth {
                    slope: falls.known[last] - falls.known[last - 1],
                    curve: 0.0,
                }
            }
        }
        (forecast, falls)
    }
}

/// Number of modes: rest, uniform, falling, attached, accelerated.
const MODES: usize = 4 + ACCELERATIONS;
/// Mode number of rest.
pub(super) const REST: usize = 0;
/// Mode number of uniform motion.
pub(super) const FLOATING: usize = 1;
/// Mode number of falling.
pub(super) const FALLING: usize = 2;
/// Mode number of attached.
pub(super) const ATTACHED: usize = 3;
/// Mode number of the track's own acceleration. The observed one has the next.
pub(super) const ACCELERATED: usize = 4;

/// Greatest expected duration of an acceleration, in ticks.
const ACCELERATION_LASTS: f64 = 16.0;

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

/// The prediction modes of one body in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorldModes<'a> {
    subject: &'a Subject<'a>,
    /// Age of the track of the present parent.
    parent_age: Option<Age>,
    /// True if the parent is removed; the body then needs a keyframe.
    pub(super) orphaned: bool,
    pub(super) floating: Predictor,
    falling: Predictor,
    gravity: Option<DVec3>,
    accelerations: [Option<ConstantAcceleration>; ACCELERATIONS],
}

impl<'a> WorldModes<'a> {
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
        Self {
            subject,
            parent_age: above.and_then(|(_, slot)| context.tracks.age(&slot.track(), subject.tick)),
            orphaned: now.parent.is_some() && above.is_none(),
            floating,
            falling,
            gravity: Some(gravity).filter(|by| context.features.ballistic && *by != DVec3::ZERO),
            accelerations: accelerations(context, subject, reach, gravity),
        }
    }

    /// The moving mode that is the track's own.
    pub(super) fn own_moving(&self) -> Option<usize> {
        let now = self.subject.track;
        match now.predictor {
            _ if now.parent.is_some() => None,
            predictor if predictor == self.floating => Some(FLOATING),
            predictor if predictor == self.falling => Some(FALLING),
            Predictor::Accelerated(_) => Some(ACCELERATED),
            _ => None,
        }
    }

    /// The acceleration of a moving mode, m/s², and its greatest expected duration in ticks. `None` if the mode does
    /// not apply.
    pub(super) fn acceleration(&self, number: usize) -> Option<(DVec3, f64)> {
        match number {
            FLOATING => Some((DVec3::ZERO, f64::INFINITY)),
            FALLING => Some((self.gravity?, f64::INFINITY)),
            _ => {
                let acceleration = self.accelerations[number - ACCELERATED]?;
                Some((acceleration.acceleration(), ACCELERATION_LASTS))
            }
        }
    }

    /// The prediction of a mode in the world; `None` if the mode does not apply.
    pub(super) fn prediction(&self, number: usize) -> Option<Prediction<'a>> {
        let predictor = match number {
            REST => Predictor::Rest,
            FLOATING => self.floating,
            FALLING => self.falling,
            _ => Predictor::Accelerated(self.accelerations[number - ACCELERATED]?),
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
}

/// Share of the parent's tolerance up to which its prediction stands for its pose. Beyond, an update of it is due soon.
const PARENT_SHARE: f64 = 0.6;

/// The attached mode of one body. Errors are in metres and radians, in the frame of the parent.
#[derive(Debug)]
pub(super) struct Attached<'a> {
    context: &'a Context<'a>,
    subject: &'a Subject<'a>,
    mode: PredictionMode,
    parent: &'a Parent<'a>,
    /// True if the body is attached to this parent already.
    is_attached: bool,
    /// The predicted motion in the frame of the parent.
    predicted: Motion,
    /// The error of the uncorrected prediction.
    pub(super) now: Errors,
    /// Its growth, from past observations.
    pub(super) growth: Growth,
}

impl<'a> Attached<'a> {
    /// `None` if the mode does not apply.
    pub(super) fn new(context: &'a Context<'a>, subject: &'a Subject<'a>) -> Option<Self> {
        let parent = subject.parent.as_ref()?;
        let (track, tracks) = (subject.track, context.tracks);
        let above = parent.slot.track();
        let is_attached = track.parent == Some(parent.slot.id(parent.index));
        let may_be =
            track.parent.is_none() && above.parent.is_none() && parent.index != subject.index;
        if !context.features.attached || !is_attached && !may_be {
            return None;
        }
        // A body without past observations has no evidence of being attached.
        let past = parent.past?;
        let now = relative_to(&parent.truth.pose(), &subject.truth.pose());
        let moved = |stride: usize| {
            let (own, of) = (subject.past[stride]?, past[stride].as_ref()?);
            let past = relative_to(&observed_pose(of), &observed_pose(own));
            Some(apart(&now.pose(), &past.pose()))
        };
        let one = moved(0)?;
        let two = moved(1).unwrap_or(one * 2.0);
        let by = parent.predicted_motion.pose();
        let truth = relative_to(&by, &subject.truth.pose());
        let predicted = if is_attached {
            *subject.framed
        } else {
            relative_to(&by, &subject.predicted_motion.pose())
        };
        Some(Self {
            context,
            subject,
            mode: if is_attached {
                PredictionMode::Same
            } else {
                PredictionMode::Attached {
                    parent: parent.index,
                    parent_age: tracks.age(&above, subject.tick)?,
                }
            },
            parent,
            is_attached,
            predicted,
            now: apart(&truth.pose(), &predicted.pose()),
            growth: growth_of_moves([one, two], subject.stride),
        })
    }

    /// True if the body is attached, or moves with the parent by its velocities: apart by less than the tolerance in a
    /// tick.
    pub(super) fn moves_along(&self, units: &Units) -> bool {
        let (subject, parent) = (self.subject, self.parent);
        let (own, other) = (subject.truth.twist(), parent.truth.twist());
        let arm = subject.truth.pose().position - parent.truth.pose().position;
        let drift = own.linear - other.linear - other.angular.cross(arm);
        self.is_attached || units.share(&Errors::of_position(drift, units.moving)) <= 1.0
    }

    pub(super) fn prediction(&self) -> Prediction<'_> {
        Prediction {
            mode: self.mode,
            predictor: Predictor::Rest,
            parent: Some(self.parent),
            motion: &self.predicted,
        }
    }

    /// The error of the uncorrected prediction at a tick within the lookahead, where `truth` is the body's motion.
    fn error(&self, tick: usize, truth: &Motion) -> Option<Errors> {
        let by = self.expected_parent_pose(tick)?;
        let relative = relative_to(&by, &truth.pose());
        Some(apart(&relative.pose(), &self.predicted.pose()))
    }

    /// Expected pose of the parent after `ticks`: the predicted one, or the true one if an update of it is due before.
    fn expected_parent_pose(&self, ticks: usize) -> Option<Pose> {
        let truth = self.parent.ahead.get(ticks - 1)?.pose();
        let (tracks, slot) = (self.context.tracks, self.parent.slot);
        let tick = self.subject.tick + Ticks::new(ticks as u32);
        let predicted_motion = tracks.framed((self.parent.index, slot), &slot.track(), tick);
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
}

/// Number of candidate accelerations: the track's own, and the observed one.
const ACCELERATIONS: usize = 2;
/// Relative difference of two accelerations below which they count as equal: of two ticks, or of a tick and gravity.
const EQUAL_WITHIN: f64 = 0.1;
/// Ticks in which a worthwhile acceleration moves a body by the tolerance: fewer than the first, more than the second.
///
/// A weaker one does not pay for its bits. A stronger one does not hold.
const WORTHWHILE_TICKS: [f64; 2] = [32.0, 1.0];
/// Least number of steps of the greatest component of the observed acceleration.
const STEPS_MIN: f64 = 32.0;

/// Candidate accelerations of a body's next track; the present track's own is the first.
fn accelerations(
    context: &Context<'_>,
    subject: &Subject<'_>,
    reach: f64,
    gravity: DVec3,
) -> [Option<ConstantAcceleration>; ACCELERATIONS] {
    let mut all = [None; ACCELERATIONS];
    let spins = context.features.torque_free || !subject.slot.is_torque_free();
    if !context.features.accelerated || !spins {
        return all;
    }
    all[0] = subject.track.predictor.acceleration();
    all[1] = acceleration(context, subject, reach, gravity)
        .and_then(|observed| ConstantAcceleration::nearest(observed, STEPS_MIN));
    all
}

/// A steady, worthwhile acceleration, m/s². `reach`: the greatest allowed error of position, metres.
fn acceleration(
    context: &Context<'_>,
    subject: &Subject<'_>,
    reach: f64,
    gravity: DVec3,
) -> Option<DVec3> {
    let between = |before, after| context.tracks.acceleration(subject.slot, before, after);
    let velocity = |motion: &Motion| motion.twist().linear;
    let now = velocity(subject.truth);
    let [(before, after), (other, next)] = match (subject.ahead, subject.velocities) {
        ([next, last, ..], _) => {
            let next = velocity(next);
            [(now, next), (next, velocity(last))]
        }
        (_, Some([one, two])) => [(one, now), (two, one)],
        _ => return None,
    };
    let acceleration = between(before, after);
    let strength = acceleration.length_squared();
    let step = context.tracks.integrator().rate.step().seconds();
    // Squares are compared: a root less.
    let once = reach * 2.0 / (step * step);
    let bound = |ticks: f64| (once / (ticks * ticks)) * (once / (ticks * ticks));
    if strength <= bound(WORTHWHILE_TICKS[0]) || strength >= bound(WORTHWHILE_TICKS[1]) {
        return None;
    }
    let near = |other: DVec3| {
        acceleration.distance_squared(other) < EQUAL_WITHIN * EQUAL_WITHIN * strength
    };
    // The ballistic predictor covers gravity.
    let falls = near(gravity);
    (!falls && near(between(other, next))).then_some(acceleration)
}

/// Cost of an update's alias gap in the packet, in 1/256 bits.
const OVERHEAD: u32 = 4 * 256;

/// Cost of other updates that is added to a correction's, in 1/256 bits, and their lifetime in ticks.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Beside {
    bits: f64,
    ticks: f64,
}

impl Beside {
    /// Assumed cost (15 bits) and lifetime (2.5 ticks) of the update after the lookahead. Without it, short and cheap
    /// updates always win.
    const NEXT: Self = Self {
        bits: 15.0 * 256.0,
        ticks: 2.5,
    };
}

/// Cost function of the corrections of one prediction mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cost {
    mode: PredictionMode,
    /// Age of the corrected track.
    age: Age,
    beside: Beside,
}

impl Cost {
    pub(super) const fn new(mode: PredictionMode, age: Age, beside: Beside) -> Self {
        Self { mode, age, beside }
    }

    /// Cost of a correction, in 1/256 bits.
    fn bits(&self, residual: &Residual) -> u32 {
        let velocity = residual.velocity.as_ref();
        self.of_form(velocity.is_some())
            + Self::of_place(residual)
            + velocity.map_or(0, |velocity| self.of_velocity(velocity))
    }

    /// Cost of the form, with or without velocities, and of the alias gap.
    pub(super) fn of_form(&self, moved: bool) -> u32 {
        OVERHEAD + InitialCostModel.cost_of_form(&self.mode, self.age, moved)
    }

    /// Cost of position and turn, the same for all modes.
    pub(super) fn of_place(residual: &Residual) -> u32 {
        InitialCostModel.cost_of_place(residual)
    }

    /// Cost of velocities.
    pub(super) fn of_velocity(&self, velocity: &VelocityResidual) -> u32 {
        InitialCostModel.cost_of_velocity(&self.mode, self.age, velocity)
    }

    /// Cost per tick; infinite for a correction that does not hold.
    pub(super) fn price(&self, bits: u32, ticks: f64) -> f64 {
        if ticks > 0.0 {
            (self.beside.bits + f64::from(bits)) / (self.beside.ticks + ticks)
        } else {
            f64::INFINITY
        }
    }

    /// Cost function of the next correction of the same track, `age` later; it includes the bits and ticks of this one.
    fn following(&self, bits: u32, ticks: usize, age: Age) -> Self {
        let beside = Beside {
            bits: self.beside.bits + f64::from(bits),
            ticks: self.beside.ticks + ticks as f64,
        };
        Self::new(PredictionMode::Same, age, beside)
    }
}

/// Rounding to the nearest step, of position and of turn.
pub(super) const NEAREST: [f64; 2] = [0.5; 2];
/// Candidate exponents of velocities: their steps are doubled so often.
pub(super) const VELOCITY_EXPONENTS: [u32; 6] = [9, 7, 5, 3, 1, 0];
/// Numbers of known ticks that the next correction is fitted to.
const FITS_AFTER: [usize; 2] = [0, 3];

/// Parameters of the search for one body's correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    pub(super) expectation: Expectation,
    pub(super) features: Features,
    /// Age of the corrected track.
    pub(super) age: Age,
    /// The share of a correction that a moving mode adds to it in each tick.
    pub(super) rate: f64,
}

/// Prices the corrections of one candidate.
#[derive(Clone, Copy, Debug)]
pub(super) struct CorrectionRanker<'s> {
    pub(super) forecast: ErrorForecast<'s>,
    pub(super) expectation: &'s Expectation,
    cost: Cost,
    /// See [`Settings::rate`]; zero for a resting mode.
    pub(super) rate: f64,
}

impl<'s> CorrectionRanker<'s> {
    /// The ranker of a mode's corrections; `None` if the mode does not apply.
    pub(super) fn new(
        settings: &'s Settings,
        candidates: &'s Candidates<'_>,
        mode: usize,
    ) -> Option<Self> {
        let prediction = candidates.prediction(mode)?;
        Some(Self {
            forecast: candidates.error_forecast(mode)?,
            expectation: &settings.expectation,
            cost: Cost::new(prediction.mode, settings.age, Beside::NEXT),
            rate: if prediction.moves() {
                settings.rate
            } else {
                0.0
            },
        })
    }

    fn effect(&self, residual: &Residual) -> Effect {
        let units = &self.expectation.units;
        let at_once = units.of_residual(residual);
        let each_tick = at_once * self.rate;
        Effect {
            at_once,
            each_tick: match &residual.velocity {
                Some(velocity) => each_tick + units.of_velocity(velocity),
                None => each_tick,
            },
        }
    }

    fn lifetime(&self, effect: &Effect) -> Lifetime {
        self.forecast.lifetime(effect, self.expectation)
    }

    pub(super) fn price(&self, residual: &Residual) -> f64 {
        let lifetime = self.lifetime(&self.effect(residual));
        self.cost.price(self.cost.bits(residual), lifetime.ticks)
    }

    /// Removes one step of each axis if that lowers the price, and calls `note` for each result.
    pub(super) fn leave_out_steps(
        &self,
        from: (Residual, f64),
        note: &mut impl FnMut(Residual, f64),
    ) -> (Residual, f64) {
        let (mut best, mut least) = from;
        for axis in 0..6 {
            let steps = |residual: &Residual| match axis {
                0..3 => residual.position[axis],
                _ => residual.turn[axis - 3],
            };
            let now = steps(&best);
            if now == 0 {
                continue;
            }
            let mut fewer = best;
            match axis {
                0..3 => fewer.position[axis] -= now.signum(),
                _ => fewer.turn[axis - 3] -= now.signum(),
            }
            let price = self.price(&fewer);
            note(fewer, price);
            if price < least {
                (best, least) = (fewer, price);
            }
        }
        (best, least)
    }

    /// Prices the corrections with velocities that reduce the error by `slope` per tick, and calls `note` for each.
    pub(super) fn with_velocities(
        &self,
        settings: &Settings,
        residual: &Residual,
        slope: &Errors,
        note: &mut impl FnMut(Residual, f64),
    ) {
        let units = &self.expectation.units;
        let effect = self.effect(residual);
        let place = self.cost.of_form(true) + Cost::of_place(residual);
        let lacking = *slope - effect.each_tick;
        for velocity_exponent in settings.features.steps(VELOCITY_EXPONENTS) {
            let velocity = units.velocity(&lacking, velocity_exponent);
            let bits = place + self.cost.of_velocity(&velocity);
            let residual = Residual {
                velocity: Some(velocity),
                ..*residual
            };
            if velocity.is_within_limits() {
                let ticks = self.lifetime(&self.effect(&residual)).ticks;
                note(residual, self.cost.price(bits, ticks));
            }
        }
    }

    /// The price of a correction together with the next one, if the breach lies within the known ticks.
    pub(super) fn price_with_next(&self, residual: &Residual) -> f64 {
        let effect = self.effect(residual);
        let lifetime = self.lifetime(&effect);
        let bits = self.cost.bits(residual);
        let breach = match lifetime.breach {
            None | Some(0) => return self.cost.price(bits, lifetime.ticks),
            Some(breach) => breach,
        };
        let interval = self.expectation.interval;
        let known = self.forecast.known_after(breach, &effect);
        let later = CorrectionRanker {
            forecast: ErrorForecast {
                known: known.errors(),
                acceleration: None,
                slope: self.forecast.slope - effect.each_tick,
                ..self.forecast
            },
            expectation: self.expectation,
            cost: self
                .cost
                .following(bits, breach, Age::new(breach.div_ceil(interval) as u32)),
            rate: if self.rate > 0.0 {
                1.0 / breach as f64
            } else {
                0.0
            },
        };
        let mut least = f64::INFINITY;
        for fit in FITS_AFTER {
            if fit <= later.forecast.last() {
                let nearest = later.forecast.nearest(fit, later.rate);
                let residual = self.expectation.units.residual(&nearest, NEAREST);
                let (_, price) =
                    later.leave_out_steps((residual, later.price(&residual)), &mut |_, _| {});
                least = least.min(price);
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_price_is_bits_per_tick_and_infinite_without_a_lifetime() {
        let cost = Cost::new(PredictionMode::Same, Age::new(3), Beside::default());
        let bits = cost.bits(&Residual::default());
        assert!(bits > OVERHEAD);
        assert_eq!(cost.price(bits, 4.0), f64::from(bits) / 4.0);
        assert_eq!(cost.price(bits, 0.0), f64::INFINITY);
        let next = cost.following(bits, 4, Age::new(4));
        assert_eq!(next.price(bits, 4.0), f64::from(bits) / 4.0);
    }
}
