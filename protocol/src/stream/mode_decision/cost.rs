//! Stage two: the price of a correction, in bits per tick of its lifetime.
//!
//! The coder's state is that at the start of a packet, because the packet's other updates are not known yet. A
//! correction that breaks the tolerance within the lookahead is priced together with the next correction.

use rhumb_reckoning::{Residual, VelocityResidual};

use super::candidates::Candidates;
use super::forecast::{Effect, ErrorForecast, Errors, Expectation, Lifetime};
use crate::packet::{Age, CostModel, InitialCostModel, PredictionMode};
use crate::stream::Features;

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
