//! Stage three without lookahead: one correction for each mode, and the cheapest of them.
//!
//! Without known ticks nothing is searched. The modes of one frame share the correction at the published tick and its
//! cost, so that a mode adds its form and its lifetime alone.

use rhumb_reckoning::Residual;

use super::candidates::{ATTACHED, Candidates, REST};
use super::cost::Cost;
use super::errors::Errors;
use super::forecast::Effect;
use super::ranking::{CorrectionRanker, NEAREST, Settings};

/// Rounding of a correction without velocities: a smaller fraction of a step is dropped, because the tolerance hardly
/// needs it.
const SPARSE: [f64; 2] = [0.6; 2];
/// Corrections at most: at rest, moving, attached, and moving with velocities.
const CORRECTIONS: usize = 4;

/// The correction at the published tick; all modes of one frame share it.
#[derive(Clone, Copy, Debug)]
struct Start {
    residual: Residual,
    at_once: Errors,
    /// Its cost without the form.
    bits: u32,
}

impl Start {
    fn new(settings: &Settings, now: &Errors) -> Self {
        let units = &settings.expectation.units;
        let rounding = if settings.features.sparse {
            SPARSE
        } else {
            NEAREST
        };
        let residual = units.residual(now, rounding);
        Self {
            residual,
            at_once: units.of_residual(&residual),
            bits: Cost::of_place(settings.age, &residual),
        }
    }

    /// The price of this correction in a mode.
    fn price(&self, ranker: &CorrectionRanker<'_>) -> f64 {
        let effect = Effect {
            at_once: self.at_once,
            each_tick: self.at_once * ranker.rate,
        };
        let bits = ranker.cost.of_form(false) + self.bits;
        ranker.cost.price(bits, ranker.lifetime(&effect).ticks)
    }
}

/// The corrections of one body, with their modes and prices.
#[derive(Clone, Copy, Debug)]
pub(super) struct SinglePass {
    choices: [(usize, f64); CORRECTIONS],
    world: Start,
    attached: Option<Start>,
    /// The correction with velocities, if it is among the choices.
    with_velocities: Option<Residual>,
}

/// The place of the correction with velocities among the choices.
const WITH_VELOCITIES: usize = CORRECTIONS - 1;

impl SinglePass {
    /// Prices the corrections of a body.
    pub(super) fn new<const N: usize>(settings: &Settings, candidates: &Candidates<'_, N>) -> Self {
        let world = Start::new(settings, candidates.error());
        let mut pass = Self {
            choices: [(REST, f64::INFINITY); CORRECTIONS],
            world,
            attached: candidates
                .attached_error()
                .map(|error| Start::new(settings, error)),
            with_velocities: None,
        };
        if candidates.orphaned {
            return pass;
        }
        let steadiest = candidates.steadiest();
        // A moving mode of its own is worth keeping; only a body without one considers the steadiest.
        let moving = candidates.own_moving().or(steadiest);
        let moving = moving.filter(|_| settings.features.derived);
        pass.consider(settings, candidates, 0, REST);
        if let Some(mode) = moving {
            pass.consider(settings, candidates, 1, mode);
        }
        if pass.attached.is_some() {
            pass.consider(settings, candidates, 2, ATTACHED);
        }
        if let Some(mode) = steadiest {
            pass.consider_velocities(settings, candidates, mode);
        }
        pass
    }

    fn consider<const N: usize>(
        &mut self,
        settings: &Settings,
        candidates: &Candidates<'_, N>,
        place: usize,
        mode: usize,
    ) {
        if let Some(ranker) = CorrectionRanker::new(settings, candidates, mode) {
            self.choices[place] = (mode, self.start(mode).price(&ranker));
        }
    }

    /// The correction without velocities of a mode.
    fn start(&self, mode: usize) -> &Start {
        match &self.attached {
            Some(attached) if mode == ATTACHED => attached,
            _ => &self.world,
        }
    }

    /// Prices the correction of a moving mode with velocities.
    fn consider_velocities<const N: usize>(
        &mut self,
        settings: &Settings,
        candidates: &Candidates<'_, N>,
        mode: usize,
    ) {
        let Some(ranker) = CorrectionRanker::new(settings, candidates, mode) else {
            return;
        };
        let limit = self
            .choices
            .iter()
            .fold(f64::INFINITY, |least, (_, price)| least.min(*price));
        let residual = settings
            .expectation
            .units
            .residual(candidates.error(), NEAREST);
        ranker.with_velocities(
            settings,
            &residual,
            &candidates.velocity,
            limit,
            &mut |residual, price| {
                self.choices[WITH_VELOCITIES] = (mode, price);
                self.with_velocities = Some(residual);
            },
        );
    }

    /// The first result of `accept`, which gets the mode and residual of each correction, the cheapest first.
    pub(super) fn cheapest<T>(
        mut self,
        accept: impl Fn(usize, Residual) -> Option<T>,
    ) -> Option<T> {
        loop {
            let mut place = 0;
            for other in 1..CORRECTIONS {
                if self.choices[other].1 < self.choices[place].1 {
                    place = other;
                }
            }
            let (mode, price) = self.choices[place];
            if price == f64::INFINITY {
                return None;
            }
            self.choices[place].1 = f64::INFINITY;
            let residual = self.with_velocities.filter(|_| place == WITH_VELOCITIES);
            let accepted = accept(mode, residual.unwrap_or(self.start(mode).residual));
            if accepted.is_some() {
                return accepted;
            }
        }
    }
}
