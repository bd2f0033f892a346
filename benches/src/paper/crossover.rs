//! From where on one curve lies above another.

use serde::{Deserialize, Serialize};

/// Two values at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    /// Where: other work in milliseconds, or bodies.
    pub(super) at: f64,
    /// What is to be beaten.
    pub(super) own: f64,
    /// What may beat it, by being greater.
    pub(super) other: f64,
}

/// Where the other first beats the own, and where it does so no more.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Crossover {
    /// Between the last pair before and the first that beats, in proportion to the differences.
    pub(super) from: f64,
    /// Whether the very first pair beats already, so that the crossover lies there or before.
    pub(super) from_the_first: bool,
    /// Where it ends, if it does within what was measured.
    pub(super) to: Option<f64>,
}

/// The crossover of pairs in ascending order of place; `None` if no pair beats. Equal values beat nothing.
pub(super) fn crossover(pairs: &[Pair]) -> Option<Crossover> {
    let beats = |pair: &Pair| pair.other > pair.own;
    let first = pairs.iter().position(beats)?;
    let end = pairs[first..].iter().position(|pair| !beats(pair));
    let between = |one: &Pair, two: &Pair| {
        let (before, after) = (one.other - one.own, two.other - two.own);
        one.at + (two.at - one.at) * before / (before - after)
    };
    Some(Crossover {
        from: match first.checked_sub(1) {
            Some(before) => between(&pairs[before], &pairs[first]),
            None => pairs[first].at,
        },
        from_the_first: first == 0,
        to: end.map(|end| between(&pairs[first + end - 1], &pairs[first + end])),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs(values: &[(f64, f64, f64)]) -> Vec<Pair> {
        let pair = |(at, own, other): &(f64, f64, f64)| Pair {
            at: *at,
            own: *own,
            other: *other,
        };
        values.iter().map(pair).collect()
    }

    #[test]
    fn a_crossover_lies_where_straight_lines_cross() {
        // Differences −2 at 10 and +6 at 50: zero a quarter of the way on.
        let found = crossover(&pairs(&[
            (10.0, 5.0, 3.0),
            (50.0, 4.0, 10.0),
            (100.0, 1.0, 9.0),
        ]));
        let expected = Crossover {
            from: 20.0,
            from_the_first: false,
            to: None,
        };
        assert_eq!(found, Some(expected));
    }

    #[test]
    fn what_never_beats_has_no_crossover_and_equals_beat_nothing() {
        assert_eq!(
            crossover(&pairs(&[(0.0, 5.0, 3.0), (50.0, 4.0, 4.0)])),
            None
        );
        assert_eq!(crossover(&[]), None);
        // From a tie on it is the tie's place.
        let found = crossover(&pairs(&[(0.0, 4.0, 4.0), (50.0, 4.0, 5.0)])).unwrap();
        assert_eq!((found.from, found.from_the_first), (0.0, false));
    }

    #[test]
    fn what_beats_from_the_first_says_so_and_may_end() {
        let found = crossover(&pairs(&[
            (5.0, 1.0, 2.0),
            (10.0, 2.0, 3.0),
            (20.0, 3.0, 2.0),
        ]));
        let expected = Crossover {
            from: 5.0,
            from_the_first: true,
            to: Some(15.0),
        };
        assert_eq!(found, Some(expected));
    }
}
