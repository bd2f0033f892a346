//! Which correction serves longest per bit, where the future is known.
//!
//! Only publishers with lookahead come here. Every correction near those that fit the known ticks is weighed by what it
//! costs, how long it holds and, where it breaks within what is known, by the best correction that then follows. Like
//! all choosing it is not normative.

use glam::DVec3;
use rhumb_reckoning::{Pose, Predictor, Residual, Ticks, Track, relative_to};

use super::choose::{
    Chooser, ModeCandidate, OVERHEAD, ParentCandidate, Subject, apart, error_growth, share,
};
use super::forecast::{ErrorForecast, ForecastErrors, Lifetime, SPAN};
use crate::packet::{Age, CostModel, InitialCostModel, PredictionMode, UpdatePayload};

/// Corrections that are weighed with what follows them, for each mode.
const SHORTLIST: usize = 6;
/// Corrections begin at the best fits of so many known ticks …
const FITS: [usize; 5] = [0, 1, 2, 4, 6];
/// … those that follow at these …
const FITS_AFTER: [usize; 4] = [0, 1, 3, 5];
/// … and go step by step to better ones, so many times at most.
const ROUNDS: usize = 8;
const ROUNDS_AFTER: usize = 1;
/// Velocities are said by lines through so many known ticks, and only where one more shows where they lead; in steps that
/// are doubled so often.
const LINES: [usize; 3] = [2, 4, 6];
const VELOCITY_EXPONENTS: [u32; 10] = [9, 8, 7, 6, 5, 4, 3, 2, 1, 0];
/// What comes after all that is weighed is taken to cost so much, in 1/256 bits, for so many ticks: without it, what
/// costs little for a tick would always win.
const NEXT_UPDATE_COST_AND_LIFETIME: (f64, f64) = (15.0 * 256.0, 2.5);
/// Whose track held for so many ticks flies: lookahead ends before it strays, and its last ticks tell more.
const LONG_TRACK_TICKS: Ticks = Ticks::new(12);
/// A parent_candidate is predicted_motion while it uses less of its tolerance than this: beyond, it is spoken of soon.
const PARENT_ERROR_SHARE: f64 = 0.6;

/// A correction, and what it is worth: bits in 256ths by ticks, less is better.
#[derive(Clone, Copy, Debug)]
struct RankedCorrection {
    residual: Residual,
    price: f64,
}

/// The best corrections so far, the best first, none twice.
#[derive(Clone, Copy, Debug, Default)]
struct BestCorrections {
    ranked_corrections: [Option<RankedCorrection>; SHORTLIST],
}

impl BestCorrections {
    fn note(&mut self, ranked: RankedCorrection) {
        let known = |other: &Option<RankedCorrection>| {
            other.is_some_and(|it| it.residual == ranked.residual)
        };
        let worse =
            |other: &Option<RankedCorrection>| other.is_none_or(|it| it.price > ranked.price);
        let at = self.ranked_corrections.iter().position(worse);
        let Some(at) =
            at.filter(|_| ranked.price.is_finite() && !self.ranked_corrections.iter().any(known))
        else {
            return;
        };
        self.ranked_corrections[at..].rotate_right(1);
        self.ranked_corrections[at] = Some(ranked);
    }
}

/// Weighs the corrections of one body by one mode.
#[derive(Clone, Copy, Debug)]
struct CorrectionRanker {
    forecast: ErrorForecast,
    mode: PredictionMode,
    age: Age,
    /// Ticks from one that the stream speaks of to the next.
    publish_interval: u32,
    /// What was said before, in 1/256 bits, and for how many ticks that held.
    before: (f64, f64),
}

impl CorrectionRanker {
    fn price(&self, residual: &Residual) -> f64 {
        let off = self.forecast.after(residual);
        let lifetime = self.forecast.lifetime(&off);
        self.worth(residual, lifetime)
    }

    fn worth(&self, residual: &Residual, lifetime: Lifetime) -> f64 {
        if lifetime.ticks <= 0.0 || !residual.is_within_limits() {
            return f64::INFINITY;
        }
        let (bits, ticks) = (
            self.before.0 + NEXT_UPDATE_COST_AND_LIFETIME.0,
            self.before.1 + NEXT_UPDATE_COST_AND_LIFETIME.1,
        );
        (bits + self.cost(residual)) / (ticks + lifetime.ticks)
    }

    fn cost(&self, residual: &Residual) -> f64 {
        let payload = UpdatePayload::Residual {
            mode: self.mode,
            age: self.age,
            residual: *residual,
        };
        f64::from(InitialCostModel.cost(&payload) + OVERHEAD)
    }

    /// Goes from a correction to better ones next to it; `note` is told of all that are met.
    fn descend(&self, from: Residual, rounds: usize, note: &mut impl FnMut(RankedCorrection)) {
        let weighed = |residual: Residual| RankedCorrection {
            residual,
            price: self.price(&residual),
        };
        let mut here = weighed(from);
        note(here);
        for _ in 0..rounds {
            let mut best = here;
            for place in 0..6 {
                for by in [-1, 1] {
                    let mut residual = here.residual;
                    match place {
                        0..3 => residual.position[place] += by,
                        _ => residual.turn[place - 3] += by,
                    }
                    let ranked = weighed(residual);
                    note(ranked);
                    if ranked.price < best.price {
                        best = ranked;
                    }
                }
            }
            if best.price >= here.price {
                return;
            }
            here = best;
        }
    }

    /// The worth of a correction together with the one that must follow it, if that is known.
    fn worth_with_next(&self, residual: &Residual) -> f64 {
        let off = self.forecast.after(residual);
        let lifetime = self.forecast.lifetime(&off);
        match lifetime.breach {
            None | Some(0) => self.worth(residual, lifetime),
            Some(breach) => self.next(residual, &off, breach).best(),
        }
    }

    /// What is to be weighed when a correction no longer holds.
    fn next(&self, residual: &Residual, off: &ForecastErrors, breach: usize) -> Self {
        let age = Age::new((breach as u32).div_ceil(self.publish_interval));
        let age_s = breach as f64 * self.forecast.step_s;
        let (bits, ticks) = self.before;
        Self {
            forecast: self.forecast.from(breach, off, age_s),
            mode: PredictionMode::Same,
            age,
            before: (bits + self.cost(residual), ticks + breach as f64),
            ..*self
        }
    }

    /// The worth of the best correction that implies its velocities.
    fn best(&self) -> f64 {
        let mut best = f64::INFINITY;
        for fit in FITS_AFTER {
            if fit <= self.forecast.known {
                let from = self.forecast.nearest(fit);
                self.descend(from, ROUNDS_AFTER, &mut |ranked| {
                    best = best.min(ranked.price)
                });
            }
        }
        best
    }
}

impl Chooser<'_> {
    /// The best correction of a body of which it is known what it does next; `None` where none was found.
    pub(crate) fn decide_mode(&self, subject: &Subject<'_>) -> Option<(UpdatePayload, Track)> {
        let track = subject.track;
        let ticks = subject.tick.since(track.origin)?;
        let flies = ticks >= LONG_TRACK_TICKS && track.predictor != Predictor::Rest;
        let age = self.tracks.age(track, subject.tick)?;
        let blind = subject.ahead.is_empty() || !self.features.mode_decision;
        if age == Age::new(0) || flies || blind || !self.features.residuals {
            return None;
        }
        let mut best: Option<(f64, UpdatePayload, Track)> = None;
        let frames = self.frames(subject);
        let mode_candidates = self.mode_candidates(subject, &frames);
        for mode_candidate in mode_candidates
            .numbers()
            .filter_map(|number| mode_candidates.mode_candidate(number))
        {
            let ranker = CorrectionRanker {
                forecast: self.forecast(subject, &mode_candidate, ticks),
                mode: mode_candidate.mode,
                age,
                publish_interval: self.tracks.publish_interval().get(),
                before: (0.0, 0.0),
            };
            for ranked in self.shortlist(&ranker).ranked_corrections.iter().flatten() {
                let price = ranker.worth_with_next(&ranked.residual);
                if best.is_none_or(|(least, ..)| price < least)
                    && let Some((payload, track)) =
                        self.kept(subject, &mode_candidate, age, ranked.residual)
                {
                    best = Some((price, payload, track));
                }
            }
        }
        best.map(|(_, payload, track)| (payload, track))
    }

    /// The corrections that are worth weighing with what follows them.
    fn shortlist(&self, ranker: &CorrectionRanker) -> BestCorrections {
        let mut list = BestCorrections::default();
        let forecast = &ranker.forecast;
        let moves = forecast.over_s.is_some();
        let rounds = if self.features.sparse { ROUNDS } else { 0 };
        if !moves || self.features.derived {
            for fit in FITS {
                if fit <= forecast.known {
                    ranker.descend(forecast.nearest(fit), rounds, &mut |ranked| {
                        list.note(ranked)
                    });
                }
            }
        }
        for line in LINES {
            if !moves || line >= forecast.known {
                break;
            }
            let (residual, faster) = forecast.line(line);
            for faster in faster {
                for velocity_exponent in self.features.steps(VELOCITY_EXPONENTS) {
                    let residual = Residual {
                        velocity: Some(forecast.velocity(faster, velocity_exponent)),
                        ..residual
                    };
                    let price = ranker.price(&residual);
                    list.note(RankedCorrection { residual, price });
                }
            }
        }
        list
    }

    /// What is known of a body on a mode.
    fn forecast(
        &self,
        subject: &Subject<'_>,
        mode_candidate: &ModeCandidate<'_>,
        age: Ticks,
    ) -> ErrorForecast {
        let slot = subject.slot;
        let rate = self.tracks.integrator().rate;
        let moves = mode_candidate.predictor != Predictor::Rest;
        let mut errors = [[DVec3::ZERO; 2]; SPAN];
        errors[0] = apart(
            &mode_candidate.frame.truth.pose(),
            &mode_candidate.frame.predicted.pose(),
        );
        let mut known = 0;
        for (place, then) in (1..SPAN).zip(subject.ahead) {
            let ticks = Ticks::new(place as u32);
            let truth = match mode_candidate.frame.parent_candidate {
                None => *then,
                Some(parent_candidate) => {
                    match self.where_attached(subject, parent_candidate, ticks) {
                        Some(by) => relative_to(&by, &then.pose()),
                        None => break,
                    }
                }
            };
            let expected = if moves {
                let (predictor, start) =
                    (mode_candidate.predictor, &mode_candidate.frame.predicted);
                self.tracks
                    .predicted_after(slot, predictor, start, subject.tick, ticks)
            } else {
                mode_candidate.frame.predicted
            };
            errors[place] = apart(&truth.pose(), &expected.pose());
            known = place;
        }
        let [last, before] = [errors[known], errors[known.saturating_sub(1)]];
        ErrorForecast {
            off: ForecastErrors {
                errors,
                rate: [0, 1].map(|i| last[i] - before[i]),
            },
            known,
            ends: subject.ends && known == subject.ahead.len(),
            grid: *self.tracks.grid(slot),
            step_s: rate.step().seconds(),
            over_s: moves.then(|| subject.track.predictor.divergence_time(age, rate).seconds()),
            allowance: self.allowance(subject),
            lasts: mode_candidate.lasts,
            error_growth: error_growth(subject),
        }
    }

    /// Where a parent_candidate will be predicted_motion to be, or is when it is spoken of before.
    fn where_attached(
        &self,
        subject: &Subject<'_>,
        parent_candidate: &ParentCandidate<'_>,
        ticks: Ticks,
    ) -> Option<Pose> {
        let truth = parent_candidate
            .ahead
            .get(ticks.count() as usize - 1)?
            .pose();
        let track = &parent_candidate.slot.track();
        let predicted_motion = self
            .tracks
            .framed(
                (parent_candidate.index, parent_candidate.slot),
                track,
                subject.tick + ticks,
            )
            .pose();
        let tolerance = self.tracks.tolerance_of(parent_candidate.slot);
        let used = share(
            &truth,
            &predicted_motion,
            tolerance,
            self.tracks.radius(parent_candidate.slot),
        );
        Some(if used <= PARENT_ERROR_SHARE {
            predicted_motion
        } else {
            truth
        })
    }

    /// What a correction leads to, if that keeps the promise.
    fn kept(
        &self,
        subject: &Subject<'_>,
        mode_candidate: &ModeCandidate<'_>,
        age: Age,
        residual: Residual,
    ) -> Option<(UpdatePayload, Track)> {
        let payload = UpdatePayload::Residual {
            mode: mode_candidate.mode,
            age,
            residual,
        };
        let (index, tick) = (subject.index, subject.tick);
        let said = self.tracks.corrected_track(index, tick, &payload);
        let track = said.ok()?;
        let begun = track.start(self.tracks.grid(subject.slot));
        let used = self.exact_share(subject, mode_candidate.frame, &begun.pose());
        (used <= self.slack.max(1.0)).then_some((payload, track))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn ranked(steps: i32, price: f64) -> RankedCorrection {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        RankedCorrection { residual, price }
    }

    proptest! {
        #[test]
        fn a_shortlist_holds_the_best_in_order_and_none_twice(
            prices in proptest::collection::vec(0_u32..50, 0..40), again in 0_usize..40,
        ) {
            let ranked_corrections: Vec<_> = (0..).zip(&prices).map(|(steps, price)| ranked(steps, f64::from(*price))).collect();
            let mut list = BestCorrections::default();
            for ranked in ranked_corrections.iter().chain(ranked_corrections.get(again)) {
                list.note(*ranked);
            }
            list.note(ranked(-1, f64::INFINITY));
            let mut best = prices.clone();
            best.sort_unstable();
            best.truncate(SHORTLIST);
            let kept: Vec<_> = list.ranked_corrections.iter().flatten().collect();
            let kept_prices: Vec<_> = kept.iter().map(|ranked| ranked.price as u32).collect();
            prop_assert_eq!(kept_prices, best);
            for (place, ranked) in kept.iter().enumerate() {
                prop_assert!(kept[..place].iter().all(|other| other.residual != ranked.residual));
            }
        }
    }
}
