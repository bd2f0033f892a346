//! Stage three: the residual of least price, over all candidates.
//!
//! The search starts at the residuals that fit the known ticks best, and removes steps while that lowers the price.

use rhumb_reckoning::Residual;

use super::candidates::{ATTACHED, Candidates};
use super::cost::{Beside, Cost};
use super::errors::Errors;
use super::forecast::Effect;
use super::ranking::{CorrectionRanker, NEAREST, Settings};
use super::shortlist::{BestCorrections, Choice};

/// Rounding for a sparser residual: a fraction of a step below this is dropped.
const SPARSE: f64 = 0.7;
/// Numbers of known ticks that residuals without velocities are fitted to.
const FITS: [usize; 5] = [0, 1, 2, 4, 6];
/// Numbers of known ticks that residuals with velocities are fitted to, by a straight line.
const LINES: [usize; 3] = [2, 4, 6];

/// The search for one body's correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refinement<'r> {
    settings: &'r Settings,
    /// The best corrections so far, cheapest first.
    pub(super) best: BestCorrections,
    /// The start of all modes in the world.
    start: Option<Start>,
}

/// The correction that fits the published tick best; all modes of one frame share it.
#[derive(Clone, Copy, Debug)]
struct Start {
    residual: Residual,
    at_once: Errors,
    /// Its bits without the form: for a mode that is the track's, and for one that differs.
    bits: [Option<u32>; 2],
}

impl Start {
    fn new(ranker: &CorrectionRanker<'_>) -> Self {
        let units = &ranker.expectation.units;
        let residual = units.residual(&ranker.forecast.known[0], NEAREST);
        Self {
            residual,
            at_once: units.of_residual(&residual),
            bits: [None; 2],
        }
    }

    /// Its cost without velocities, the form included.
    fn bits(&mut self, cost: &Cost) -> u32 {
        let (residual, bits) = (&self.residual, &mut self.bits[usize::from(cost.changes())]);
        cost.of_form(false) + *bits.get_or_insert_with(|| cost.of_place(residual, false))
    }
}

impl<'r> Refinement<'r> {
    pub(super) fn new(settings: &'r Settings) -> Self {
        Self {
            settings,
            best: BestCorrections::default(),
            start: None,
        }
    }

    /// The ranker of a mode's corrections; `None` if the mode does not apply.
    fn ranker<'s, const N: usize>(
        &self,
        candidates: &'s Candidates<'_, N>,
        number: usize,
    ) -> Option<CorrectionRanker<'s>>
    where
        'r: 's,
    {
        let beside = if self.settings.looks_ahead {
            Beside::NEXT
        } else {
            Beside::default()
        };
        let prediction = candidates.prediction(number)?;
        Some(CorrectionRanker {
            forecast: candidates.error_forecast(number)?,
            expectation: &self.settings.expectation,
            cost: Cost::new(prediction.mode, self.settings.age, beside),
            rate: if prediction.moves() {
                self.settings.rate
            } else {
                0.0
            },
        })
    }

    fn note(&mut self, mode: usize, residual: Residual, price: f64) {
        self.best.note(Choice {
            mode,
            residual,
            price,
        });
    }

    /// Prices the corrections of a mode.
    pub(super) fn consider<const N: usize>(&mut self, candidates: &Candidates<'_, N>, mode: usize) {
        let Some(ranker) = self.ranker(candidates, mode) else {
            return;
        };
        let moves = ranker.rate > 0.0;
        if self.settings.looks_ahead {
            return self.consider_known(mode, moves, &ranker);
        }
        if moves && !self.settings.features.derived {
            return;
        }
        let own = &mut None;
        let start = match mode {
            ATTACHED => own,
            _ => &mut self.start,
        };
        let start = start.get_or_insert_with(|| Start::new(&ranker));
        let effect = Effect {
            at_once: start.at_once,
            each_tick: start.at_once * ranker.rate,
        };
        let form = ranker.cost.of_form(false);
        if let Some(ticks) = ranker.lifetime_within(form, &effect, self.best.least()) {
            let (residual, bits) = (start.residual, start.bits(&ranker.cost));
            self.note(mode, residual, ranker.cost.price(bits, ticks));
        }
    }

    /// Prices the corrections of a moving mode with velocities.
    pub(super) fn consider_velocities<const N: usize>(
        &mut self,
        candidates: &Candidates<'_, N>,
        mode: usize,
    ) {
        if let Some(ranker) = self.ranker(candidates, mode) {
            let units = &ranker.expectation.units;
            let residual = units.residual(&ranker.forecast.known[0], NEAREST);
            let (settings, velocity) = (self.settings, &candidates.velocity);
            ranker.with_velocities(settings, (mode, &residual), velocity, &mut self.best);
        }
    }

    /// Prices the best correction without the steps that the tolerance hardly needs.
    pub(super) fn consider_sparse<const N: usize>(&mut self, candidates: &Candidates<'_, N>) {
        if let Some(best) = self.best.first().filter(|_| self.settings.features.sparse)
            && let Some(ranker) = self.ranker(candidates, best.mode)
        {
            let units = &ranker.expectation.units;
            let sparse = Residual {
                velocity: best.residual.velocity,
                ..units.residual(&ranker.forecast.known[0], [SPARSE; 2])
            };
            let (bits, effect) = (ranker.cost.bits(&sparse), ranker.effect(&sparse));
            if sparse != best.residual
                && let Some(ticks) = ranker.lifetime_within(bits, &effect, best.price)
            {
                self.note(best.mode, sparse, ranker.cost.price(bits, ticks));
            }
        }
    }

    /// Prices the corrections of a candidate with lookahead: the best ones together with their next correction.
    fn consider_known(&mut self, mode: usize, moves: bool, ranker: &CorrectionRanker<'_>) {
        let settings = self.settings;
        let (forecast, units) = (&ranker.forecast, &ranker.expectation.units);
        let mut best = BestCorrections::default();
        if !moves || settings.features.derived {
            for fit in FITS.into_iter().take_while(|fit| *fit <= forecast.last()) {
                let residual = units.residual(&forecast.nearest(fit, ranker.rate), NEAREST);
                let price = ranker.price(&residual);
                let mut note = |residual, price| {
                    best.note(Choice {
                        mode,
                        residual,
                        price,
                    });
                };
                note(residual, price);
                if settings.features.sparse {
                    ranker.leave_out_steps((residual, price), None, &mut note);
                }
            }
        }
        let lines = if moves { &LINES[..] } else { &[] };
        for line in lines
            .iter()
            .copied()
            .take_while(|line| *line < forecast.last())
        {
            let [begin, slope] = forecast.line(line);
            let residual = units.residual(&begin, NEAREST);
            let nearest = forecast.slope_from(line, &units.of_residual(&residual));
            for slope in [slope, nearest] {
                ranker.with_velocities(settings, (mode, &residual), &slope, &mut best);
            }
        }
        for choice in best.iter() {
            let price = ranker.price_with_next(&choice.residual);
            self.best.note(Choice { price, ..*choice });
        }
    }
}
