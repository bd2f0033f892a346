//! Stage one with lookahead: the modes that apply, each with its forecast.
//!
//! The moving modes differ only by their acceleration, so that they share one unaccelerated forecast.

use glam::DVec3;
use rhumb_reckoning::{Motion, Predictor, Ticks};

use super::attached::Attached;
use super::errors::{Errors, Units, apart};
use super::forecast::{Acceleration, ErrorForecast, Known, SPAN};
use super::modes::{ATTACHED, FLOATING, MODES, Prediction, REST, WorldModes};
use super::recent::{FallGrowth, Growth, RecentMotion};
use super::subject::{Context, Subject};

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
