//! Finds where one curve rises above another.

use serde::Serialize;

/// Two values at one abscissa.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pair {
    /// Abscissa: other work in milliseconds, or bodies.
    pub(crate) at: f64,
    /// Value of the baseline.
    pub(crate) own: f64,
    /// Value of the challenger, which beats the baseline by being greater.
    pub(crate) other: f64,
}

/// An interval in which the challenger beats the baseline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Crossover {
    /// Start, interpolated between the last pair before and the first pair that beats.
    pub(crate) from: f64,
    /// True if the first pair already beats; the true start may then lie earlier.
    pub(crate) from_the_first: bool,
    /// End, if it lies within the measured range.
    pub(crate) to: Option<f64>,
}

/// The intervals in which the challenger beats the baseline; pairs in ascending order. Ties do not beat.
pub(crate) fn crossovers(pairs: &[Pair]) -> Vec<Crossover> {
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
        // Differences −2 at 10 and +6 at 50: zero at a quarter of the distance.
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
    fn a_challenger_that_never_beats_has_no_crossover() {
        assert_eq!(crossovers(&pairs(&[(0.0, 5.0, 3.0), (50.0, 4.0, 4.0)])), []);
        assert_eq!(crossovers(&[]), []);
        // After a tie, the interval starts at the tie.
        let found = crossovers(&pairs(&[(0.0, 4.0, 4.0), (50.0, 4.0, 5.0)]));
        assert_eq!((found[0].from, found[0].from_the_first), (0.0, false));
    }

    #[test]
    fn intervals_may_start_at_the_first_pair_end_and_start_again() {
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
