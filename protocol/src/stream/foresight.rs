//! Which correction serves longest per bit, where the future is known.
//!
//! Only publishers with hindsight come here. Every correction near those that fit the known ticks is weighed by what it
//! costs, how long it holds and, where it breaks within what is known, by the best correction that then follows. Like
//! all choosing it is not normative.

use glam::DVec3;
use rhumb_reckoning::{Pose, Predictor, Residual, Ticks, Track, seen_from};

use super::choose::{Chooser, Holder, OVERHEAD, Subject, Way, apart, doubt, share};
use super::outlook::{Life, Off, Outlook, SPAN};
use super::tracks::Former;
use crate::packet::{Age, Course, Opening, Pricing, Saying};

/// Corrections that are weighed with what follows them, for each course.
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
const COARSENESSES: [u32; 10] = [9, 8, 7, 6, 5, 4, 3, 2, 1, 0];
/// What comes after all that is weighed is taken to cost so much, in 1/256 bits, for so many ticks: without it, what
/// costs little for a tick would always win.
const AFTERWARDS: (f64, f64) = (15.0 * 256.0, 2.5);
/// Whose track held for so many ticks flies: hindsight ends before it strays, and its last ticks tell more.
const FLIGHT: Ticks = Ticks::new(12);
/// A holder is believed while it uses less of its tolerance than this: beyond, it is spoken of soon.
const HOLDER_SHARE: f64 = 0.6;

/// A correction, and what it is worth: bits in 256ths by ticks, less is better.
#[derive(Clone, Copy, Debug)]
struct Word {
    residual: Residual,
    price: f64,
}

/// The best corrections so far, the best first, none twice.
#[derive(Clone, Copy, Debug, Default)]
struct Shortlist {
    words: [Option<Word>; SHORTLIST],
}

impl Shortlist {
    fn note(&mut self, word: Word) {
        let known = |other: &Option<Word>| other.is_some_and(|it| it.residual == word.residual);
        let worse = |other: &Option<Word>| other.is_none_or(|it| it.price > word.price);
        let at = self.words.iter().position(worse);
        let Some(at) = at.filter(|_| word.price.is_finite() && !self.words.iter().any(known))
        else {
            return;
        };
        self.words[at..].rotate_right(1);
        self.words[at] = Some(word);
    }
}

/// Weighs the corrections of one body by one course.
#[derive(Clone, Copy, Debug)]
struct Scales {
    outlook: Outlook,
    course: Course,
    age: Age,
    /// Ticks from one that the stream speaks of to the next.
    every: u32,
    /// What was said before, in 1/256 bits, and for how many ticks that held.
    before: (f64, f64),
}

impl Scales {
    fn price(&self, residual: &Residual) -> f64 {
        let off = self.outlook.after(residual);
        let life = self.outlook.life(&off);
        self.worth(residual, life)
    }

    fn worth(&self, residual: &Residual, life: Life) -> f64 {
        if life.ticks <= 0.0 || !residual.is_within_limits() {
            return f64::INFINITY;
        }
        let (bits, ticks) = (self.before.0 + AFTERWARDS.0, self.before.1 + AFTERWARDS.1);
        (bits + self.cost(residual)) / (ticks + life.ticks)
    }

    fn cost(&self, residual: &Residual) -> f64 {
        let saying = Saying::Residual {
            course: self.course,
            age: self.age,
            residual: *residual,
        };
        f64::from(Opening.cost(&saying) + OVERHEAD)
    }

    /// Goes from a correction to better ones next to it; `note` is told of all that are met.
    fn descend(&self, from: Residual, rounds: usize, note: &mut impl FnMut(Word)) {
        let weighed = |residual: Residual| Word {
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
                    let word = weighed(residual);
                    note(word);
                    if word.price < best.price {
                        best = word;
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
        let off = self.outlook.after(residual);
        let life = self.outlook.life(&off);
        match life.breach {
            None | Some(0) => self.worth(residual, life),
            Some(breach) => self.next(residual, &off, breach).best(),
        }
    }

    /// What is to be weighed when a correction no longer holds.
    fn next(&self, residual: &Residual, off: &Off, breach: usize) -> Self {
        let age = Age::new((breach as u32).div_ceil(self.every));
        let age_s = breach as f64 * self.outlook.step_s;
        let (bits, ticks) = self.before;
        Self {
            outlook: self.outlook.from(breach, off, age_s),
            course: Course::Same,
            age,
            before: (bits + self.cost(residual), ticks + breach as f64),
            ..*self
        }
    }

    /// The worth of the best correction that implies its velocities.
    fn best(&self) -> f64 {
        let mut best = f64::INFINITY;
        for fit in FITS_AFTER {
            if fit <= self.outlook.known {
                let from = self.outlook.nearest(fit);
                self.descend(from, ROUNDS_AFTER, &mut |word| best = best.min(word.price));
            }
        }
        best
    }
}

impl Chooser<'_> {
    /// The best correction of a body of which it is known what it does next; `None` where none was found.
    pub(crate) fn foresee(&self, subject: &Subject<'_>) -> Option<(Saying, Track)> {
        let track = subject.track;
        let ticks = subject.tick.since(track.origin)?;
        let flies = ticks >= FLIGHT && track.predictor != Predictor::Rest;
        let age = self.tracks.age(track, subject.tick)?;
        let blind = subject.ahead.is_empty() || !self.features.foresight;
        if age == Age::new(0) || flies || blind || !self.features.residuals {
            return None;
        }
        let mut best: Option<(f64, Saying, Track)> = None;
        let frames = self.frames(subject);
        let ways = self.ways(subject, &frames);
        for way in ways.numbers().filter_map(|number| ways.way(number)) {
            let scales = Scales {
                outlook: self.outlook(subject, &way, ticks),
                course: way.course,
                age,
                every: self.tracks.every().get(),
                before: (0.0, 0.0),
            };
            for word in self.shortlist(&scales).words.iter().flatten() {
                let price = scales.worth_with_next(&word.residual);
                if best.is_none_or(|(least, ..)| price < least)
                    && let Some((saying, track)) = self.kept(subject, &way, age, word.residual)
                {
                    best = Some((price, saying, track));
                }
            }
        }
        best.map(|(_, saying, track)| (saying, track))
    }

    /// The corrections that are worth weighing with what follows them.
    fn shortlist(&self, scales: &Scales) -> Shortlist {
        let mut list = Shortlist::default();
        let outlook = &scales.outlook;
        let moves = outlook.over_s.is_some();
        let rounds = if self.features.sparse { ROUNDS } else { 0 };
        if !moves || self.features.derived {
            for fit in FITS {
                if fit <= outlook.known {
                    scales.descend(outlook.nearest(fit), rounds, &mut |word| list.note(word));
                }
            }
        }
        for line in LINES {
            if !moves || line >= outlook.known {
                break;
            }
            let (residual, faster) = outlook.line(line);
            for faster in faster {
                for coarseness in self.features.steps(COARSENESSES) {
                    let residual = Residual {
                        velocity: Some(outlook.velocity(faster, coarseness)),
                        ..residual
                    };
                    let price = scales.price(&residual);
                    list.note(Word { residual, price });
                }
            }
        }
        list
    }

    /// What is known of a body on a course.
    fn outlook(&self, subject: &Subject<'_>, way: &Way<'_>, age: Ticks) -> Outlook {
        let slot = subject.slot;
        let rate = self.tracks.integrator().rate;
        let moves = way.predictor != Predictor::Rest;
        let mut errors = [[DVec3::ZERO; 2]; SPAN];
        errors[0] = apart(&way.frame.truth.pose(), &way.frame.predicted.pose());
        let mut known = 0;
        for (place, then) in (1..SPAN).zip(subject.ahead) {
            let ticks = Ticks::new(place as u32);
            let truth = match way.frame.holder {
                None => *then,
                Some(holder) => match self.where_held(subject, holder, ticks) {
                    Some(by) => seen_from(&by, &then.pose()),
                    None => break,
                },
            };
            let expected = if moves {
                let (law, start) = (way.predictor, &way.frame.predicted);
                self.tracks.foreseen(slot, law, start, subject.tick, ticks)
            } else {
                way.frame.predicted
            };
            errors[place] = apart(&truth.pose(), &expected.pose());
            known = place;
        }
        let [last, before] = [errors[known], errors[known.saturating_sub(1)]];
        Outlook {
            off: Off {
                errors,
                rate: [0, 1].map(|i| last[i] - before[i]),
            },
            known,
            ends: subject.ends && known == subject.ahead.len(),
            grid: *self.tracks.grid(slot),
            step_s: rate.step().seconds(),
            over_s: moves.then(|| subject.track.predictor.astray(age, rate).seconds()),
            allowance: self.allowance(subject),
            lasts: way.lasts,
            doubt: doubt(subject),
        }
    }

    /// Where a holder will be believed to be, or is when it is spoken of before.
    fn where_held(&self, subject: &Subject<'_>, holder: &Holder<'_>, ticks: Ticks) -> Option<Pose> {
        let truth = holder.ahead.get(ticks.count() as usize - 1)?.pose();
        let track = &holder.slot.track();
        let believed = self
            .tracks
            .framed((holder.index, holder.slot), track, subject.tick + ticks)
            .pose();
        let tolerance = self.tracks.tolerance_of(holder.slot);
        let used = share(
            &truth,
            &believed,
            tolerance,
            self.tracks.radius(holder.slot),
        );
        Some(if used <= HOLDER_SHARE {
            believed
        } else {
            truth
        })
    }

    /// What a correction leads to, if that keeps the promise.
    fn kept(
        &self,
        subject: &Subject<'_>,
        way: &Way<'_>,
        age: Age,
        residual: Residual,
    ) -> Option<(Saying, Track)> {
        let saying = Saying::Residual {
            course: way.course,
            age,
            residual,
        };
        let (index, tick) = (subject.index, subject.tick);
        let said = self.tracks.said(index, tick, &saying, Former::default());
        let track = said.ok()?;
        let begun = track.start(self.tracks.grid(subject.slot));
        let used = self.exact_share(subject, way.frame, &begun.pose());
        (used <= self.slack.max(1.0)).then_some((saying, track))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn word(steps: i32, price: f64) -> Word {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        Word { residual, price }
    }

    proptest! {
        #[test]
        fn a_shortlist_holds_the_best_in_order_and_none_twice(
            prices in proptest::collection::vec(0_u32..50, 0..40), again in 0_usize..40,
        ) {
            let words: Vec<_> = (0..).zip(&prices).map(|(steps, price)| word(steps, f64::from(*price))).collect();
            let mut list = Shortlist::default();
            for word in words.iter().chain(words.get(again)) {
                list.note(*word);
            }
            list.note(word(-1, f64::INFINITY));
            let mut best = prices.clone();
            best.sort_unstable();
            best.truncate(SHORTLIST);
            let kept: Vec<_> = list.words.iter().flatten().collect();
            let kept_prices: Vec<_> = kept.iter().map(|word| word.price as u32).collect();
            prop_assert_eq!(kept_prices, best);
            for (place, word) in kept.iter().enumerate() {
                prop_assert!(kept[..place].iter().all(|other| other.residual != word.residual));
            }
        }
    }
}
