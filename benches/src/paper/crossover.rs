//! From where on one curve lies above another.

use serde::Serialize;

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

/// A stretch on which the other beats the own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Crossover {
    /// Between the last pair before and the first that beats, in proportion to the differences.
    pub(super) from: f64,
    /// Whether the very first pair beats already, so that the crossover lies there or before.
    pub(super) from_the_first: bool,
    /// Where it ends, if it does within what was measured.
    pub(super) to: Option<f64>,
}

/// The stretches on which the other beats, of pairs in ascending order of place. Equal values beat nothing.
pub(super) fn crossovers(pairs: &[Pair]) -> Vec<Crossover> {
    let beats = |pair: &Pair| pair.other > pair.own;
    let between = |one: &Pair, two: &Pair| {
        let (before, after) = (one.other - one.own, two.other - two.own);
        one.at + (two.at - one.at) * before / (before - after)
    };
    let (mut found, mut before): (Vec<Crossover>, Option<&Pair>) = (Vec::new(), None);
    for pair in pairs {
        match before.filter(|before| beats(before) != beats(pair)) {
            Some(before) if beats(pair) => found.push(Crossover {
                from: between(before, pair),
                from_the_first: false,
                to: None,
            }),
            Some(before) => {
                if let Some(open) = found.last_mut() {
                    open.to = Some(between(before, pair));
                }
            }
            None if before.is_none() && beats(pair) => found.push(Crossover {
                from: pair.at,
                from_the_first: true,
                to: None,
            }),
            None => {}
        }
        before = Some(pair);
    }
    found
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
        let found = crossovers(&pairs(&[
            (10.0, 5.0, 3.0),
            (50.0, 4.0, 10.0),
            (100.0, 1.0, 9.0),
        ]));
        let expected = Crossover {
            from: 20.0,
            from_the_first: false,
            to: None,
        };
        assert_eq!(found, [expected]);
    }

    #[test]
    fn what_never_beats_has_no_crossover_and_equals_beat_nothing() {
        assert_eq!(crossovers(&pairs(&[(0.0, 5.0, 3.0), (50.0, 4.0, 4.0)])), []);
        assert_eq!(crossovers(&[]), []);
        // From a tie on it is the tie's place.
        let found = crossovers(&pairs(&[(0.0, 4.0, 4.0), (50.0, 4.0, 5.0)]));
        assert_eq!((found[0].from, found[0].from_the_first), (0.0, false));
    }

    #[test]
    fn what_beats_from_the_first_says_so_and_may_end_and_beat_again() {
        let found = crossovers(&pairs(&[
            (5.0, 1.0, 2.0),
            (10.0, 2.0, 3.0),
            (20.0, 3.0, 2.0),
            (30.0, 3.0, 2.0),
            (40.0, 3.0, 6.0),
        ]));
        let first = Crossover {
            from: 5.0,
            from_the_first: true,
            to: Some(15.0),
        };
        let again = Crossover {
            from: 32.5,
            from_the_first: false,
            to: None,
        };
        assert_eq!(found, [first, again]);
    }
}
