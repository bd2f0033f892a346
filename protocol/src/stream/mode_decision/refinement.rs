//! Stage three with lookahead: the residuals of least price.
//!
//! The search starts at the residuals that fit the known ticks best, and removes steps while that lowers the price. The
//! best ones of each candidate are priced together with their next correction.

use super::candidates::Candidates;
use super::ranking::{CorrectionRanker, NEAREST, Settings};
use super::shortlist::{BestCorrections, Choice};

/// Numbers of known ticks that residuals without velocities are fitted to.
const FITS: [usize; 5] = [0, 1, 2, 4, 6];
/// Numbers of known ticks that residuals with velocities are fitted to, by a straight line.
const LINES: [usize; 3] = [2, 4, 6];

/// The best corrections of a body, the cheapest first.
pub(super) fn refined(settings: &Settings, candidates: &Candidates<'_>) -> BestCorrections {
    let mut all = BestCorrections::default();
    for mode in candidates.modes() {
        let Some(ranker) = CorrectionRanker::new(settings, candidates, mode) else {
            continue;
        };
        for choice in best_of(settings, mode, &ranker).iter() {
            let price = ranker.price_with_next(&choice.residual);
            all.note(Choice { price, ..*choice });
        }
    }
    all
}

/// The best corrections of one candidate, without their next corrections.
fn best_of(settings: &Settings, mode: usize, ranker: &CorrectionRanker<'_>) -> BestCorrections {
    let (forecast, units) = (&ranker.forecast, &ranker.expectation.units);
    let moves = ranker.rate > 0.0;
    let mut best = BestCorrections::default();
    let mut note = |residual, price| {
        best.note(Choice {
            mode,
            residual,
            price,
        });
    };
    if !moves || settings.features.derived {
        for fit in FITS.into_iter().take_while(|fit| *fit <= forecast.last()) {
            let residual = units.residual(&forecast.nearest(fit, ranker.rate), NEAREST);
            let price = ranker.price(&residual);
            note(residual, price);
            if settings.features.sparse {
                ranker.leave_out_steps((residual, price), &mut note);
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
        let at_once = units.of_residual(&residual);
        let nearest = forecast.slope_from(line, &at_once);
        for slope in [slope, nearest] {
            ranker.with_velocities(settings, &residual, &slope, &mut note);
        }
    }
    best
}
