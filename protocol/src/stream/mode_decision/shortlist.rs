//! The best corrections of one body so far.
//!
//! Computes no prices. Invariant: the corrections are in order, the cheapest first, without duplicates.

use rhumb_reckoning::Residual;

/// Number of corrections that are kept: with lookahead they are priced with their next correction.
const SHORTLIST: usize = 3;

/// A correction, and its price in 1/256 bits per tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct Choice {
    /// Number of the prediction mode.
    pub(super) mode: usize,
    pub(super) residual: Residual,
    pub(super) price: f64,
}

/// The best corrections so far, the cheapest first, without duplicates.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BestCorrections {
    choices: [Option<Choice>; SHORTLIST],
}

impl BestCorrections {
    pub(super) fn iter(&self) -> impl Iterator<Item = &Choice> {
        self.choices.iter().flatten()
    }

    /// Inserts a correction if it is among the best.
    pub(super) fn note(&mut self, choice: Choice) {
        let mut at = 0;
        for other in self.choices.iter().flatten() {
            if other.price > choice.price {
                break;
            }
            let same = other.price == choice.price && other.mode == choice.mode;
            if same && other.residual == choice.residual {
                return;
            }
            at += 1;
        }
        if at < SHORTLIST && choice.price.is_finite() {
            self.choices.copy_within(at..SHORTLIST - 1, at + 1);
            self.choices[at] = Some(choice);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;
    use proptest::prelude::*;

    fn choice(steps: i32, price: f64) -> Choice {
        let residual = Residual {
            position: [steps, 0, 0],
            ..Residual::default()
        };
        Choice {
            mode: 0,
            residual,
            price,
        }
    }

    proptest! {
        #[test]
        fn the_best_are_kept_in_order_without_duplicates(
            prices in proptest::collection::vec(0_u32..50, 0..40), again in 0_usize..40,
        ) {
            let choices: Vec<_> = (0..)
                .zip(&prices)
                .map(|(steps, price)| choice(steps, f64::from(*price)))
                .collect();
            let mut list = BestCorrections::default();
            for choice in choices.iter().chain(choices.get(again)) {
                list.note(*choice);
            }
            list.note(choice(-1, f64::INFINITY));
            let mut best = prices.clone();
            best.sort_unstable();
            best.truncate(SHORTLIST);
            let kept: Vec<_> = list.iter().collect();
            let kept_prices: Vec<_> = kept.iter().map(|choice| choice.price as u32).collect();
            prop_assert_eq!(kept_prices, best);
            for (place, choice) in kept.iter().enumerate() {
                prop_assert!(kept[..place].iter().all(|other| other.residual != choice.residual));
            }
        }
    }
}
