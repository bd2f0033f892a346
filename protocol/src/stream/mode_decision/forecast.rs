//! The error forecast, and how long a corrected prediction holds by it.
//!
//! Nothing is predicted here. A correction takes so much off the error at once, and so much more each tick where it implies
//! velocities, so that one forecast serves all corrections of one prediction mode. That is near enough to choose by.

use super::errors::{Errors, Units};
use crate::stream::observation_history::LOOKAHEAD_MAX;

/// Ticks of a forecast: the published one, and those that lookahead knows.
pub(super) const SPAN: usize = LOOKAHEAD_MAX.count() as usize + 1;
/// Ticks beyond the known ones at which the expected error is looked at.
const LOOKS: [f64; 15] = [
    1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0, 48.0, 64.0, 96.0, 128.0, 192.0,
];

/// What a correction takes off the error: at once, and more each tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effect {
    pub(super) at_once: Errors,
    pub(super) each_tick: Errors,
}

/// Errors at the published tick and those after it, as far as they are known: of at most `N` ticks.
#[derive(Clone, Copy, Debug)]
pub(super) struct Known<const N: usize> {
    errors: [Errors; N],
    count: usize,
}

impl<const N: usize> Known<N> {
    pub(super) const fn new(now: Errors) -> Self {
        let mut errors = [Errors::ZERO; N];
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

/// A constant acceleration beside what is known: what it takes off, and by what factor at each tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pull<'a> {
    pub(super) each: Errors,
    pub(super) falls: &'a [f64],
}

/// How far off the uncorrected prediction of one mode is, tick by tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct ErrorForecast<'a> {
    /// At the published tick and those after it.
    pub(super) known: &'a [Errors],
    pub(super) pull: Option<Pull<'a>>,
    /// Beyond, the error is taken to grow by this in a tick, and by `curve` in a tick squared.
    pub(super) slope: Errors,
    pub(super) curve: Errors,
    /// Whether the body is known to leave the stream after the last known tick.
    pub(super) ends: bool,
    /// Ticks that the mode is expected to last at most.
    pub(super) lasts: f64,
}

/// Of one body, how lifetimes are estimated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expectation {
    pub(super) units: Units,
    /// What each tick adds to the expected error, as a share of the tolerance.
    pub(super) growth: f64,
    /// Ticks from one that is published to the next.
    pub(super) interval: usize,
}

/// For how long a correction holds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifetime {
    /// Ticks; none if it does not hold at all.
    pub(super) ticks: f64,
    /// The first known tick at which it does not hold.
    pub(super) breach: Option<usize>,
}

impl ErrorForecast<'_> {
    /// The last known tick.
    pub(super) const fn last(&self) -> usize {
        self.known.len() - 1
    }

    /// Without a correction.
    #[inline]
    fn error(&self, tick: usize) -> Errors {
        let error = self.known[tick];
        match &self.pull {
            Some(pull) if tick > 0 => error - pull.each * pull.falls[tick],
            _ => error,
        }
    }

    #[inline]
    fn left(&self, tick: usize, by: &Effect) -> Errors {
        self.error(tick) - by.at_once - by.each_tick * (tick as f64)
    }

    /// How long a prediction holds after a correction.
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
            let unseen = expectation.interval.saturating_sub(2) as f64;
            known + beyond.min(self.lasts) + unseen
        };
        Lifetime {
            ticks,
            breach: None,
        }
    }

    /// How many ticks more it holds if the error goes on to grow as expected; `None` if it does not hold at the beginning.
    #[inline]
    fn beyond(&self, by: &Effect, expectation: &Expectation) -> Option<f64> {
        let Expectation { units, growth, .. } = expectation;
        let begin = self.left(self.last(), by);
        let slope = self.slope - by.each_tick;
        // The square of the error is a polynomial.
        let squares = [
            begin.dot(&begin),
            begin.dot(&slope) * 2.0,
            slope.dot(&slope) + begin.dot(&self.curve) * 2.0,
            slope.dot(&self.curve) * 2.0,
            self.curve.dot(&self.curve),
        ];
        let (mut at, mut before) = (0.0, units.share_of_squares(squares[0]));
        let holds = before <= 1.0;
        if !holds {
            return None;
        }
        for look in LOOKS {
            let [zeroth, first, second, third, fourth] = squares;
            let square = (((fourth * look + third) * look + second) * look + first) * look + zeroth;
            let share = units.share_of_squares(square) + growth * look;
            if share > 1.0 {
                let part = ((1.0 - before) / (share - before)).clamp(0.0, 1.0);
                return Some(at + part * (look - at));
            }
            (at, before) = (look, share);
        }
        Some(at)
    }

    /// What is known from a later tick on, after a correction.
    pub(super) fn known_after(&self, tick: usize, by: &Effect) -> Known<SPAN> {
        let mut known = Known::new(self.left(tick, by));
        for later in tick + 1..=self.last() {
            known.push(self.left(later, by));
        }
        known
    }

    /// What a correction should take off at once to be nearest to the ticks up to one, where each tick takes off `rate` of that
    /// more.
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

    /// The slope of the line that begins there and is nearest.
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

    /// The straight line nearest to the ticks up to one: where it begins, and by how much it grows in a tick.
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

    /// Of a body whose errors without a correction are these along x, in metres.
    fn known(errors: &[f64]) -> Known<SPAN> {
        let of = |x: &f64| Errors::of_position(DVec3::X * *x, expectation().units.still);
        let mut known = Known::new(of(&errors[0]));
        errors[1..].iter().for_each(|x| known.push(of(x)));
        known
    }

    fn forecast(known: &Known<SPAN>) -> ErrorForecast<'_> {
        let slope = match known.errors() {
            [.., before, last] => *last - *before,
            _ => Errors::ZERO,
        };
        ErrorForecast {
            known: known.errors(),
            pull: None,
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
    fn what_is_known_after_a_breach_is_what_a_correction_left() {
        let known = known(&[0.0, 0.02, 0.04, 0.06]);
        let forecast = forecast(&known);
        let rest = forecast.known_after(3, &moved(0));
        let later = ErrorForecast {
            known: rest.errors(),
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
