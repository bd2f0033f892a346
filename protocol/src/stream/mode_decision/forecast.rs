//! The error forecast, and the lifetime estimate of a corrected prediction.
//!
//! No body is predicted here. A correction reduces the error by a constant and, if it implies velocities, by a constant
//! per tick. So one forecast serves all corrections of one mode. This approximation only ranks corrections.

use super::errors::{Errors, Units};
use crate::stream::observation_history::LOOKAHEAD_MAX;

/// Ticks of a forecast: the published tick and those of the lookahead.
pub(super) const SPAN: usize = LOOKAHEAD_MAX.count() as usize + 1;
/// Ticks beyond the known ones at which the expected error is evaluated.
const SAMPLED_TICKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];

/// Reduction of the error by a correction: at once, and additionally per tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effect {
    pub(super) at_once: Errors,
    pub(super) each_tick: Errors,
}

/// Errors at the published tick and at the known ticks after it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known {
    errors: [Errors; SPAN],
    count: usize,
}

impl Known {
    pub(super) const fn new(now: Errors) -> Self {
        let mut errors = [Errors::ZERO; SPAN];
        errors[0] = now;
        Self { errors, count: 1 }
    }

    pub(super) fn push(&mut self, next: Errors) {
        self.errors[self.count] = next;
        self.count += 1;
    }

    pub(super) fn errors(&self) -> &[Errors] {
        &self.errors[..self.count]
    }
}

/// Effect of a constant acceleration on the known errors: its unit reduction, and the factor at each tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acceleration<'a> {
    pub(super) each: Errors,
    pub(super) falls: &'a [f64],
}

/// Error of the uncorrected prediction of one mode, by tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorForecast<'a> {
    /// Errors at the published tick and at the known ticks after it.
    pub(super) known: &'a [Errors],
    pub(super) acceleration: Option<Acceleration<'a>>,
    /// Expected growth beyond the known ticks, per tick.
    pub(super) slope: Errors,
    /// Expected growth beyond the known ticks, per tick squared.
    pub(super) curve: Errors,
    /// True if the body leaves the stream after the last known tick.
    pub(super) ends: bool,
    /// Greatest expected duration of the mode, in ticks.
    pub(super) lasts: f64,
}

/// Parameters of the lifetime estimates of one body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expectation {
    pub(super) units: Units,
    /// Growth of the expected error per tick, as a share of the tolerance.
    pub(super) growth: f64,
    /// Publish interval, in ticks.
    pub(super) interval: usize,
}

impl Expectation {
    /// Ticks for which an error that begins and grows like this is expected to stay within the tolerance; `None` if it
    /// begins beyond.
    #[inline]
    pub(super) fn ticks_within(&self, begin: Errors, slope: Errors, curve: &Errors) -> Option<f64> {
        let Self { units, growth, .. } = self;
        // The square of the error is a polynomial of the time in ticks.
        let squares = [
            begin.dot(&begin),
            begin.dot(&slope) * 2.0,
            slope.dot(&slope) + begin.dot(curve) * 2.0,
            slope.dot(curve) * 2.0,
            curve.dot(curve),
        ];
        let (mut at, mut before) = (0.0, units.share_of_squares(squares[0]));
        let holds = before <= 1.0;
        if !holds {
            return None;
        }
        for ticks in SAMPLED_TICKS {
            let [zeroth, first, second, third, fourth] = squares;
            let square =
                (((fourth * ticks + third) * ticks + second) * ticks + first) * ticks + zeroth;
            let share = units.share_of_squares(square) + growth * ticks;
            if share > 1.0 {
                let part = ((1.0 - before) / (share - before)).clamp(0.0, 1.0);
                return Some(at + part * (ticks - at));
            }
            (at, before) = (ticks, share);
        }
        Some(at)
    }

    /// Ticks of a lifetime before the stream is published again.
    pub(super) fn unobserved(&self) -> f64 {
        self.interval.saturating_sub(2) as f64
    }
}

/// Estimated lifetime of a correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifetime {
    /// Duration in ticks; zero if the correction does not hold at all.
    pub(super) ticks: f64,
    /// The first known tick at which the correction does not hold.
    pub(super) breach: Option<usize>,
}

impl ErrorForecast<'_> {
    /// The last known tick.
    pub(super) const fn last(&self) -> usize {
        self.known.len() - 1
    }

    /// The error at a known tick without a correction.
    #[inline]
    fn error(&self, tick: usize) -> Errors {
        let error = self.known[tick];
        match &self.acceleration {
            Some(by) if tick > 0 => error - by.each * by.falls[tick],
            _ => error,
        }
    }

    #[inline]
    fn left(&self, tick: usize, by: &Effect) -> Errors {
        self.error(tick) - by.at_once - by.each_tick * (tick as f64)
    }

    /// The lifetime of the prediction after a correction.
    pub(super) fn lifetime(&self, by: &Effect, expectation: &Expectation) -> Lifetime {
        let last = self.last();
        let mut tick = 0;
        while last > 0 && tick <= last {
            let holds = expectation.units.share(&self.left(tick, by)) <= 1.0;
            if !holds {
                return Lifetime {
                    ticks: tick as f64,
                    breach: Some(tick),
                };
            }
            tick += expectation.interval;
        }
        let known = last as f64 + 1.0;
        let ticks = if self.ends {
            known
        } else {
            let Some(beyond) = self.beyond(by, expectation) else {
                return Lifetime {
                    ticks: last as f64,
                    breach: Some(last),
                };
            };
            known + beyond.min(self.lasts) + expectation.unobserved()
        };
        Lifetime {
            ticks,
            breach: None,
        }
    }

    /// Ticks for which the correction holds beyond the known ones; `None` if it does not hold at the last known tick.
    fn beyond(&self, by: &Effect, expectation: &Expectation) -> Option<f64> {
        let begin = self.left(self.last(), by);
        expectation.ticks_within(begin, self.slope - by.each_tick, &self.curve)
    }

    /// The known errors from a later tick on, after a correction.
    pub(super) fn known_after(&self, tick: usize, by: &Effect) -> Known {
        let mut known = Known::new(self.left(tick, by));
        for later in tick + 1..=self.last() {
            known.push(self.left(later, by));
        }
        known
    }

    /// The best reduction at once, by least squares over the ticks up to `last`. Each tick adds the share `rate` of it.
    pub(super) fn nearest(&self, last: usize, rate: f64) -> Errors {
        if last == 0 {
            return self.error(0);
        }
        let (mut sum, mut weight) = (Errors::ZERO, 0.0);
        for tick in 0..=last {
            let gain = 1.0 + rate * tick as f64;
            sum = sum + self.error(tick) * gain;
            weight += gain * gain;
        }
        sum * (1.0 / weight)
    }

    /// The slope of the line from `begin` that fits the ticks up to `last` best.
    pub(super) fn slope_from(&self, last: usize, begin: &Errors) -> Errors {
        let (mut times, mut squares) = (0.0, 0.0);
        let mut moment = Errors::ZERO;
        for tick in 0..=last {
            let (errors, tick) = (self.error(tick), tick as f64);
            (times, squares) = (times + tick, squares + tick * tick);
            moment = moment + errors * tick;
        }
        (moment - *begin * times) * (1.0 / squares)
    }

    /// The straight line that fits the ticks up to `last` best: its start, and its slope per tick.
    pub(super) fn line(&self, last: usize) -> [Errors; 2] {
        let (mut times, mut squares) = (0.0, 0.0);
        let (mut sum, mut moment) = (Errors::ZERO, Errors::ZERO);
        for tick in 0..=last {
            let (errors, tick) = (self.error(tick), tick as f64);
            (times, squares) = (times + tick, squares + tick * tick);
            sum = sum + errors;
            moment = moment + errors * tick;
        }
        let determinant = (last + 1) as f64 * squares - times * times;
        let begin = (sum * squares - moment * times) * (1.0 / determinant);
        let slope = (moment - begin * times) * (1.0 / squares);
        [begin, slope]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use rhumb_reckoning::{Grid, Metres, Residual, Tolerance};

    const STEP_S: f64 = 1.0 / 60.0;

    fn expectation() -> Expectation {
        let radius = Metres::new(0.5);
        let tolerance = Tolerance::from_metres(Metres::new(0.05)).unwrap();
        let grid = Grid::new(tolerance, radius);
        Expectation {
            units: Units::new(tolerance, radius, 1.0, &grid, STEP_S),
            growth: 0.01,
            interval: 1,
        }
    }

    /// The known errors of a body with these uncorrected errors along x, in metres.
    fn known(errors: &[f64]) -> Known {
        let of = |x: &f64| Errors::of_position(DVec3::X * *x, expectation().units.still);
        let mut known = Known::new(of(&errors[0]));
        errors[1..].iter().for_each(|x| known.push(of(x)));
        known
    }

    fn forecast(known: &Known) -> ErrorForecast<'_> {
        let slope = match known.errors() {
            [.., before, last] => *last - *before,
            _ => Errors::ZERO,
        };
        ErrorForecast {
            known: known.errors(),
            acceleration: None,
            slope,
            curve: Errors::ZERO,
            ends: false,
            lasts: f64::INFINITY,
        }
    }

    fn moved(steps: i32) -> Effect {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        Effect {
            at_once: expectation().units.of_residual(&residual),
            each_tick: Errors::ZERO,
        }
    }

    #[test]
    fn a_lifetime_ends_where_the_tolerance_breaks() {
        let known = known(&[0.01, 0.03, 0.049, 0.051, 0.0]);
        let forecast = forecast(&known);
        let life = forecast.lifetime(&moved(0), &expectation());
        assert_eq!((life.ticks, life.breach), (3.0, Some(3)));
        let beyond = forecast.lifetime(&moved(1), &expectation());
        assert!(beyond.breach.is_none() && beyond.ticks > 5.0);
        let ends = ErrorForecast {
            ends: true,
            ..forecast
        };
        assert_eq!(ends.lifetime(&moved(1), &expectation()).ticks, 5.0);
    }

    #[test]
    fn the_known_errors_after_a_breach_include_the_correction() {
        let known = known(&[0.0, 0.02, 0.04, 0.06]);
        let forecast = forecast(&known);
        let remaining = forecast.known_after(3, &moved(0));
        let later = ErrorForecast {
            known: remaining.errors(),
            ..forecast
        };
        assert_eq!(later.last(), 0);
        let life = |steps| later.lifetime(&moved(steps), &expectation());
        assert_eq!((life(0).ticks, life(0).breach), (0.0, Some(0)));
        assert!(life(2).ticks > 3.0);
    }

    #[test]
    fn a_straight_line_is_found() {
        let errors: [f64; SPAN] = core::array::from_fn(|tick| 0.028 + 0.03 * tick as f64);
        let known = known(&errors);
        let [begin, slope] = forecast(&known).line(SPAN - 1);
        let units = expectation().units;
        let share = |errors: Errors| units.share(&errors) * 0.05;
        assert!((share(begin) - 0.028).abs() < 1e-9 && (share(slope) - 0.03).abs() < 1e-9);
        let again = forecast(&known).slope_from(SPAN - 1, &begin);
        assert!(share(again - slope) < 1e-9);
    }
}
