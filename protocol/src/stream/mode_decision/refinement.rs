//! Stage three: the residual of each candidate that costs least for each tick that it holds.
//!
//! Corrections begin at those that fit the known ticks best, and leave out steps as long as that pays. With lookahead, those that break
//! within what is known are weighed together with the correction that must follow.

use rhumb_reckoning::Residual;

use super::candidates::{Candidate, Modes};
use super::cost::{Beside, Cost};
use super::errors::Errors;
use super::forecast::{Effect, ErrorForecast, Expectation, Lifetime};
use crate::packet::Age;
use crate::stream::features::Features;

/// Steps are rounded to the nearest.
const NEAREST: [f64; 2] = [0.5; 2];
/// Steps by which corrections are made sparser: a part of the last step below this share is left out.
const SPARSE: f64 = 0.7;
/// The velocity_exponent of velocities that are sent whether or not it pays.
const PLAIN: u32 = 3;
/// Velocities are sent in steps that are doubled so often, if at all.
const VELOCITY_EXPONENTS: [u32; 6] = [9, 7, 5, 3, 1, 0];
/// Corrections begin at the best fits of so many known ticks; moving ones with velocities at straight lines through so many.
const FITS: [usize; 5] = [0, 1, 2, 4, 6];
const LINES: [usize; 3] = [2, 4, 6];
/// Corrections that follow begin at these.
const FITS_AFTER: [usize; 2] = [0, 3];
/// Corrections that are weighed with what follows.
const SHORTLIST: usize = 3;

/// A correction, and what it is worth: 1/256 bits for each tick, less is better.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    /// The number of its mode.
    pub(super) mode: usize,
    pub(super) residual: Residual,
    price: f64,
}

/// How one body's corrections are searched.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings {
    pub(super) expectation: Expectation,
    pub(super) features: Features,
    /// Of the track that is corrected.
    pub(super) age: Age,
    /// The share of a correction that a moving mode adds to it in each tick.
    pub(super) rate: f64,
    /// Whether what follows a correction is weighed too.
    pub(super) looks_ahead: bool,
}

impl Settings {
    /// How many corrections are kept.
    const fn room(&self) -> usize {
        if self.looks_ahead { SHORTLIST } else { 2 }
    }
}

/// The best corrections so far, the best first, none twice.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BestCorrections {
    choices: [Option<Choice>; SHORTLIST],
}

impl BestCorrections {
    /// The price of the best.
    fn least(&self) -> f64 {
        self.choices[0].map_or(f64::INFINITY, |best| best.price)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Choice> {
        self.choices.iter().flatten()
    }

    /// Notes a correction, if it is among the best `room`.
    fn note(&mut self, room: usize, choice: Choice) {
        let mut at = 0;
        for other in self.choices[..room].iter().flatten() {
            if other.price > choice.price {
                break;
            }
            let same = other.price == choice.price && other.mode == choice.mode;
            if same && other.residual == choice.residual {
                return;
            }
            at += 1;
        }
        if at < room && choice.price.is_finite() {
            self.choices.copy_within(at..room - 1, at + 1);
            self.choices[at] = Some(choice);
        }
    }
}

/// The search for one body's correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refinement<'r> {
    settings: &'r Settings,
    best: BestCorrections,
    /// In the world.
    start: Option<Start>,
    /// The mode that velocities may serve best, and what it would cost if they cost nothing.
    moving: Option<(usize, f64)>,
}

/// The correction that is nearest to the published tick: all modes of one frame share it.
#[derive(Clone, Copy, Debug)]
struct Start {
    residual: Residual,
    at_once: Errors,
    /// Its bits beside its form, where that keeps the track's mode and where it changes it.
    bits: [Option<u32>; 2],
}

impl Start {
    fn new(scales: &CorrectionRanker<'_>) -> Self {
        let units = &scales.expectation.units;
        let residual = units.residual(&scales.forecast.known[0], NEAREST);
        Self {
            residual,
            at_once: units.of_residual(&residual),
            bits: [None; 2],
        }
    }

    /// What it costs without velocities, its form included.
    fn bits(&mut self, cost: &Cost) -> u32 {
        let (residual, bits) = (&self.residual, &mut self.bits[usize::from(cost.changes())]);
        cost.of_form(false) + *bits.get_or_insert_with(|| cost.of_place(residual, false))
    }
}

/// One candidate's corrections, weighed.
#[derive(Clone, Copy, Debug)]
struct CorrectionRanker<'s> {
    forecast: &'s ErrorForecast<'s>,
    expectation: &'s Expectation,
    cost: Cost,
    /// See [`Refinement::rate`]; nothing of a mode that rests.
    rate: f64,
}

impl CorrectionRanker<'_> {
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

    fn price(&self, residual: &Residual) -> f64 {
        let lifetime = self.lifetime(&self.effect(residual));
        self.cost.price(self.cost.bits(residual), lifetime.ticks)
    }

    /// Leaves out a step after another as long as that pays; only those that differ from a sparser residual, if there is one.
    fn leave_out_steps(
        &self,
        from: (Residual, f64),
        sparser: Option<&Residual>,
        note: &mut impl FnMut(Residual, f64),
    ) -> (Residual, f64) {
        let (mut best, mut least) = from;
        for axis in 0..6 {
            let steps = |residual: &Residual| match axis {
                0..3 => residual.position[axis],
                _ => residual.turn[axis - 3],
            };
            let now = steps(&best);
            if now == 0 || sparser.is_some_and(|sparser| steps(sparser) == now) {
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

    /// Weighs a correction with velocities that take `slope` off the error in each tick.
    fn with_velocities(
        &self,
        settings: &Settings,
        (mode, residual): (usize, &Residual),
        slope: &Errors,
        best: &mut BestCorrections,
    ) {
        let units = &self.expectation.units;
        let effect = self.effect(residual);
        let exact = Effect {
            each_tick: *slope,
            ..effect
        };
        // Nothing lasts longer than what goes on at the true velocities, and finer steps cost more.
        let longest = self.lifetime(&exact).ticks;
        let lacking = *slope - effect.each_tick;
        let place = self.cost.of_form(true) + self.cost.of_place(residual, true);
        for velocity_exponent in settings.features.steps(VELOCITY_EXPONENTS) {
            let velocity = units.velocity(&lacking, velocity_exponent);
            let bits = place + self.cost.of_velocity(&velocity);
            let must = !settings.features.derived && velocity_exponent <= PLAIN;
            if self.cost.price(bits, longest) >= best.least() && !must && !settings.looks_ahead {
                return;
            }
            let residual = Residual {
                velocity: Some(velocity),
                ..*residual
            };
            if velocity.is_within_limits() {
                let ticks = self.lifetime(&self.effect(&residual)).ticks;
                let price = self.cost.price(bits, ticks);
                best.note(
                    settings.room(),
                    Choice {
                        mode,
                        residual,
                        price,
                    },
                );
            }
        }
    }

    /// The price of a correction together with the one that must follow it, if that is known.
    fn price_with_next(&self, residual: &Residual) -> f64 {
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
            forecast: &ErrorForecast {
                known: known.errors(),
                pull: None,
                slope: self.forecast.slope - effect.each_tick,
                ..*self.forecast
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
                    later.leave_out_steps((residual, later.price(&residual)), None, &mut |_, _| {});
                least = least.min(price);
            }
        }
        least
    }
}

impl<'r> Refinement<'r> {
    pub(super) fn new(settings: &'r Settings) -> Self {
        Self {
            settings,
            best: BestCorrections::default(),
            start: None,
            moving: None,
        }
    }

    fn scales<'s>(&self, candidate: &'s Candidate<'_>) -> CorrectionRanker<'s>
    where
        'r: 's,
    {
        let beside = if self.settings.looks_ahead {
            Beside::NEXT
        } else {
            Beside::default()
        };
        let (mode, age) = (candidate.mode, self.settings.age);
        CorrectionRanker {
            forecast: &candidate.forecast,
            expectation: &self.settings.expectation,
            cost: Cost::new(mode, age, beside),
            rate: if candidate.moves() {
                self.settings.rate
            } else {
                0.0
            },
        }
    }

    fn note(&mut self, mode: usize, residual: Residual, price: f64) {
        let choice = Choice {
            mode,
            residual,
            price,
        };
        self.best.note(self.settings.room(), choice);
    }

    /// Weighs the corrections of a candidate. `velocity`: by how much the true velocities differ from the predicted ones.
    pub(super) fn consider(&mut self, mode: usize, candidate: &Candidate<'_>, velocity: &Errors) {
        let scales = self.scales(candidate);
        if self.settings.looks_ahead {
            return self.consider_known(mode, candidate.moves(), &scales);
        }
        let own = &mut None;
        let start = match candidate.base.parent {
            None => &mut self.start,
            Some(_) => own,
        };
        let start = start.get_or_insert_with(|| Start::new(&scales));
        let (residual, bits) = (start.residual, start.bits(&scales.cost));
        let effect = Effect {
            at_once: start.at_once,
            each_tick: start.at_once * scales.rate,
        };
        let moves = candidate.moves();
        if !moves || self.settings.features.derived {
            let ticks = scales.lifetime(&effect).ticks;
            self.note(mode, residual, scales.cost.price(bits, ticks));
        }
        if moves {
            let exact = Effect {
                each_tick: *velocity,
                ..effect
            };
            let price = scales.cost.price(bits, scales.lifetime(&exact).ticks);
            if self.moving.is_none_or(|(_, least)| price < least) {
                self.moving = Some((mode, price));
            }
        }
    }

    /// The same with lookahead: the best are weighed together with those that must follow.
    fn consider_known(&mut self, mode: usize, moves: bool, scales: &CorrectionRanker<'_>) {
        let settings = self.settings;
        let (forecast, units) = (scales.forecast, &scales.expectation.units);
        let mut best = BestCorrections::default();
        if !moves || settings.features.derived {
            for fit in FITS.into_iter().take_while(|fit| *fit <= forecast.last()) {
                let residual = units.residual(&forecast.nearest(fit, scales.rate), NEAREST);
                let price = scales.price(&residual);
                let mut note = |residual, price| {
                    best.note(
                        SHORTLIST,
                        Choice {
                            mode,
                            residual,
                            price,
                        },
                    )
                };
                note(residual, price);
                if settings.features.sparse {
                    scales.leave_out_steps((residual, price), None, &mut note);
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
                scales.with_velocities(settings, (mode, &residual), &slope, &mut best);
            }
        }
        for choice in best.iter() {
            let price = scales.price_with_next(&choice.residual);
            self.best.note(SHORTLIST, Choice { price, ..*choice });
        }
    }

    /// The best corrections in order.
    pub(super) fn finish(&mut self, modes: &Modes<'_>, velocity: &Errors) -> &BestCorrections {
        if self.settings.looks_ahead {
            return &self.best;
        }
        if let Some((mode, price)) = self.moving
            && price < self.best.least()
            && let Some(candidate) = &modes[mode]
        {
            let scales = self.scales(candidate);
            let units = &scales.expectation.units;
            let residual = units.residual(&scales.forecast.known[0], NEAREST);
            scales.with_velocities(self.settings, (mode, &residual), velocity, &mut self.best);
        }
        if let Some(best) = self.best.choices[0].filter(|_| self.settings.features.sparse)
            && let Some(candidate) = &modes[best.mode]
        {
            let scales = self.scales(candidate);
            let units = &scales.expectation.units;
            let sparse = units.residual(&scales.forecast.known[0], [SPARSE; 2]);
            let found =
                scales.leave_out_steps((best.residual, best.price), Some(&sparse), &mut |_, _| {});
            self.note(best.mode, found.0, found.1);
        }
        &self.best
    }
}
