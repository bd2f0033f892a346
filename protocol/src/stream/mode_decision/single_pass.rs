//! Stage three without lookahead: one correction for each mode.
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

/// A correction of one mode.
#[derive(Clone, Copy, Debug)]
struct Priced<'p> {
    price: f64,
    mode: usize,
    residual: &'p Residual,
}

/// Finds the cheapest correction that `accept` turns into a result. It gets a mode and a residual, the cheapest first.
pub(super) fn cheapest<const N: usize, T>(
    settings: &Settings,
    candidates: &Candidates<'_, N>,
    accept: impl Fn(usize, &Residual) -> Option<T>,
) -> Option<T> {
    if candidates.orphaned {
        return None;
    }
    let world = Start::new(settings, candidates.error());
    let attached = candidates.attached_error();
    let attached = attached.map(|error| Start::new(settings, error));
    let steadiest = candidates.steadiest();
    // The track's own moving mode is worth keeping; only a track without one changes to the steadiest.
    let moving = candidates.own_moving().or(steadiest);
    let moving = moving.filter(|_| settings.features.derived);
    let priced = |mode: usize, start: &'_ Start| {
        CorrectionRanker::new(settings, candidates, mode)
            .map_or(f64::INFINITY, |ranker| start.price(&ranker))
    };
    let mut choices = [Priced {
        price: f64::INFINITY,
        mode: REST,
        residual: &world.residual,
    }; 4];
    choices[0].price = priced(REST, &world);
    if let Some(mode) = moving {
        (choices[1].price, choices[1].mode) = (priced(mode, &world), mode);
    }
    if let Some(start) = &attached {
        choices[2] = Priced {
            price: priced(ATTACHED, start),
            mode: ATTACHED,
            residual: &start.residual,
        };
    }
    let limit = choices
        .iter()
        .fold(f64::INFINITY, |least, choice| least.min(choice.price));
    let mut moved = Residual::default();
    if let Some(mode) = steadiest
        && let Some(price) =
            with_velocities(settings, candidates, &world, (mode, limit), &mut moved)
    {
        choices[3] = Priced {
            price,
            mode,
            residual: &moved,
        };
    }
    first_accepted(&mut choices, accept)
}

/// Tries the corrections in order of their prices, until one is accepted.
fn first_accepted<T>(
    choices: &mut [Priced<'_>],
    accept: impl Fn(usize, &Residual) -> Option<T>,
) -> Option<T> {
    loop {
        let by_price = |a: &&mut Priced<'_>, b: &&mut Priced<'_>| a.price.total_cmp(&b.price);
        let best = choices.iter_mut().min_by(by_price)?;
        if best.price == f64::INFINITY {
            return None;
        }
        let accepted = accept(best.mode, best.residual);
        if accepted.is_some() {
            return accepted;
        }
        best.price = f64::INFINITY;
    }
}

/// The price of a moving mode's correction with velocities, which is written to `moved`; `None` if it surely exceeds
/// the limit.
fn with_velocities<const N: usize>(
    settings: &Settings,
    candidates: &Candidates<'_, N>,
    world: &Start,
    (mode, limit): (usize, f64),
    moved: &mut Residual,
) -> Option<f64> {
    let ranker = CorrectionRanker::new(settings, candidates, mode)?;
    let units = &settings.expectation.units;
    let residual = units.residual(candidates.error(), NEAREST);
    let slope = &candidates.velocity;
    let longest = ranker.longest(units.of_residual(&residual), slope);
    if ranker.least_price(world.bits, longest) >= limit {
        return None;
    }
    let mut price = None;
    ranker.with_velocities(
        settings,
        &residual,
        (slope, longest),
        &mut |residual, its_price| {
            *moved = residual;
            price = Some(its_price);
        },
    );
    price
}
