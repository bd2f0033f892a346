//! What a listener keeps so that parities give it lost packets back.
//!
//! Columns and sums only: what a rebuilt packet says is for the subscriber to read, as it reads any other. Bytes from
//! anyone: the packets of [`PARITY_SPAN`] numbers and [`PARITIES_KEPT`] parities are all that is kept, and a parity costs
//! no more than a multiplication for each byte of these.

use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

use super::columns::Columns;
use crate::limits::{PARITIES_KEPT, PARITY_SPAN};
use crate::packet::{Parity, add_times, column_into, inverse, times};

/// A parity, less the packets in it that were heard.
#[derive(Clone, Debug)]
struct Sum {
    row: u8,
    /// The packets that are still in it.
    unknown: Vec<u64>,
    column: Vec<u8>,
}

impl Sum {
    /// Takes a packet out that has become known.
    fn take(&mut self, number: u64, column: &[u8]) {
        let Some(place) = self.unknown.iter().position(|other| *other == number) else {
            return;
        };
        self.unknown.swap_remove(place);
        if self.column.len() < column.len() {
            self.column.resize(column.len(), 0);
        }
        add_times(&mut self.column, Parity::factor(self.row, number), column);
    }
}

/// A listener's last packets and the parities that it has no use for yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Restorer {
    /// One more than the highest number of which anything was heard.
    end: u64,
    columns: Columns,
    /// The column of the packet that is being heard.
    heard: Vec<u8>,
    sums: VecDeque<Sum>,
    /// Below this number nothing is rebuilt: it was said before this began, or a parity was wrong.
    distrusted: u64,
}

impl Restorer {
    /// Of a stream of which nothing before this packet will be heard.
    pub(crate) fn new(next: u64) -> Self {
        Self {
            end: next,
            distrusted: next,
            ..Self::default()
        }
    }

    /// A packet was heard.
    pub(crate) fn hear_packet(&mut self, number: u64, datagram: &[u8]) {
        let mut column = core::mem::take(&mut self.heard);
        if column_into(datagram, &mut column).is_some() {
            self.hear(number, &column);
        }
        self.heard = column;
    }

    /// A packet was heard or rebuilt, of which this is the column.
    pub(crate) fn hear(&mut self, number: u64, column: &[u8]) {
        self.advance(number + 1);
        if number < self.oldest() {
            return;
        }
        for sum in &mut self.sums {
            sum.take(number, column);
        }
        self.sums.retain(|sum| !sum.unknown.is_empty());
        self.columns.keep(number, column);
    }

    /// A parity was heard, of which this is the number of the newest packet.
    pub(crate) fn add(&mut self, last: u64, parity: Parity) {
        self.advance(last + 1);
        let mut sum = Sum {
            row: parity.row,
            unknown: parity.numbers(last).collect(),
            column: parity.sums,
        };
        for number in sum.unknown.clone() {
            if let Some(column) = self.columns.get(number) {
                sum.take(number, column);
            }
        }
        let oldest = self.oldest().max(self.distrusted);
        let of_use = sum.unknown.iter().all(|number| *number >= oldest);
        let twice = |other: &Sum| other.row == sum.row && other.unknown == sum.unknown;
        if !of_use || sum.unknown.is_empty() || self.sums.iter().any(twice) {
            return;
        }
        if self.sums.len() == PARITIES_KEPT {
            self.sums.pop_front();
        }
        self.sums.push_back(sum);
    }

    /// The packets that what was heard gives back, in order of their numbers, with their columns; again until they are
    /// counted as heard.
    pub(crate) fn rebuild(&mut self) -> Vec<(u64, Vec<u8>)> {
        if self.sums.is_empty() {
            return Vec::new();
        }
        let unknown = self.unknown();
        let rows = self.reduced(&unknown);
        rows.iter()
            .filter_map(|row| {
                let mut of = row
                    .factors
                    .iter()
                    .enumerate()
                    .filter(|(_, factor)| **factor != 0);
                let (place, _) = of.next()?;
                of.next()
                    .is_none()
                    .then(|| (unknown[place], self.mixed(row)))
            })
            .collect()
    }

    /// A rebuilt packet was none: no parity heard so far is used any more, nor is any asked for until these packets are
    /// history.
    pub(crate) fn distrust(&mut self, number: u64) {
        self.columns.forget(number);
        self.sums.clear();
        self.distrusted = self.end;
    }

    /// The column of a packet, if that was heard or rebuilt, and lately.
    pub(crate) fn column(&self, number: u64) -> Option<&[u8]> {
        self.columns.get(number)
    }

    /// How many parities more would give back those of these missing packets that lie below `next` and that parities can;
    /// none where repairs do with less.
    ///
    /// A parity that is asked for covers what was said since the oldest of them. What was repaired since is known, and its
    /// bytes are in there all the same: then more parities are needed than packets were lost, if they can be kept at all.
    pub(crate) fn wanted(&self, missing: impl Iterator<Item = u64>, next: u64) -> u8 {
        let oldest = next
            .saturating_sub(u64::from(PARITY_SPAN))
            .max(self.distrusted);
        let is_lacking = |number: &u64| self.columns.get(*number).is_none();
        if (oldest..next).filter(is_lacking).count() > PARITIES_KEPT {
            return 0;
        }
        let of_use = |number: &u64| *number >= oldest && is_lacking(number);
        let lost: Vec<u64> = missing.filter(of_use).collect();
        let Some(first) = lost.first() else {
            return 0;
        };
        let covered: Vec<u64> = (*first..next).filter(is_lacking).collect();
        // What else the sums hold comes first, so that rows are left that hold none of it.
        let mut unknown = self.unknown();
        unknown.retain(|number| covered.binary_search(number).is_err());
        let others = unknown.len();
        unknown.extend(&covered);
        let rows = self.reduced(&unknown);
        let is_of_covered = |row: &&Row| {
            let (others, covered) = row.factors.split_at(others);
            others.iter().all(|factor| *factor == 0) && covered.iter().any(|factor| *factor != 0)
        };
        let wanted = covered.len() - rows.iter().filter(is_of_covered).count();
        if wanted > lost.len() {
            return 0;
        }
        wanted as u8
    }

    /// What is known of lies below; what lies too far below that is forgotten.
    fn advance(&mut self, end: u64) {
        if end <= self.end {
            return;
        }
        self.end = end;
        let oldest = self.oldest();
        self.columns.forget_below(oldest);
        let of_use = |sum: &Sum| sum.unknown.iter().all(|number| *number >= oldest);
        self.sums.retain(of_use);
    }

    const fn oldest(&self) -> u64 {
        self.end.saturating_sub(PARITY_SPAN as u64)
    }

    /// The packets that are in any sum, in order of their numbers.
    fn unknown(&self) -> Vec<u64> {
        let all = self.sums.iter();
        let mut unknown: Vec<u64> = all.flat_map(|sum| sum.unknown.iter().copied()).collect();
        unknown.sort_unstable();
        unknown.dedup();
        unknown
    }

    /// The sums as equations of these packets, each solved for the first that it can be.
    fn reduced(&self, unknown: &[u64]) -> Vec<Row> {
        let rows = 0..self.sums.len();
        let mut rows: Vec<Row> = rows.map(|place| self.row(place, unknown)).collect();
        reduce(&mut rows, unknown.len());
        rows
    }

    fn row(&self, place: usize, unknown: &[u64]) -> Row {
        let sum = &self.sums[place];
        let factor = |number: &u64| {
            let covered = sum.unknown.contains(number);
            if covered {
                Parity::factor(sum.row, *number)
            } else {
                0
            }
        };
        let mut shares = vec![0; self.sums.len()];
        shares[place] = 1;
        Row {
            factors: unknown.iter().map(factor).collect(),
            shares,
        }
    }

    /// The sum of the parities by their shares in a row.
    fn mixed(&self, row: &Row) -> Vec<u8> {
        let used = || {
            self.sums
                .iter()
                .zip(&row.shares)
                .filter(|(_, share)| **share != 0)
        };
        let longest = used().map(|(sum, _)| sum.column.len()).max();
        let mut column = vec![0; longest.unwrap_or_default()];
        for (sum, share) in used() {
            add_times(&mut column, *share, &sum.column);
        }
        column
    }
}

/// An equation: which unknown packets it holds with which factors, and how it was made of the parities.
#[derive(Clone, Debug)]
struct Row {
    factors: Vec<u8>,
    shares: Vec<u8>,
}

impl Row {
    fn scale(&mut self, by: u8) {
        for number in self.factors.iter_mut().chain(&mut self.shares) {
            *number = times(*number, by);
        }
    }

    fn add(&mut self, by: u8, other: &Self) {
        add_times(&mut self.factors, by, &other.factors);
        add_times(&mut self.shares, by, &other.shares);
    }
}

/// Gauss-Jordan elimination: afterwards each row has a first factor of one that no other row has.
fn reduce(rows: &mut [Row], columns: usize) {
    let mut done = 0;
    for column in 0..columns {
        let Some(found) = (done..rows.len()).find(|place| rows[*place].factors[column] != 0) else {
            continue;
        };
        rows.swap(done, found);
        let factor = rows[done].factors[column];
        rows[done].scale(inverse(factor));
        let pivot = rows[done].clone();
        for (place, row) in rows.iter_mut().enumerate() {
            if place != done {
                let factor = row.factors[column];
                row.add(factor, &pivot);
            }
        }
        done += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::PARITY_ROWS;
    use proptest::collection::vec;
    use proptest::prelude::*;

    /// The parity of a row over columns with these numbers, which rise.
    fn parity(row: u8, columns: &[(u64, Vec<u8>)]) -> (u64, Parity) {
        let (last, _) = columns[columns.len() - 1];
        let mut parity = Parity::begin(row, last);
        for (number, column) in columns {
            parity.add(*number, last - number, column);
        }
        (last, parity)
    }

    fn padded(column: &[u8], bytes: usize) -> Vec<u8> {
        let mut column = column.to_vec();
        column.resize(bytes.max(column.len()), 0);
        column
    }

    #[test]
    fn who_lacks_more_than_parities_give_back_asks_for_none() {
        let lacking = |heard: u64| {
            let mut restorer = Restorer::new(0);
            (0..heard).for_each(|number| restorer.hear(number, &[1]));
            // All but the last were repaired since.
            restorer.wanted(core::iter::once(31), 32)
        };
        assert_eq!(lacking(32 - PARITIES_KEPT as u64), 1);
        assert_eq!(lacking(31 - PARITIES_KEPT as u64), 0);
    }

    #[test]
    fn who_had_repairs_since_what_is_lost_asks_for_another() {
        let mut restorer = Restorer::new(0);
        let columns: Vec<_> = (0..9).map(|number| (number, vec![number as u8])).collect();
        let heard = [0, 1, 3, 4, 6, 7, 8];
        heard
            .iter()
            .for_each(|number| restorer.hear(*number, &[*number as u8]));
        // Packet 5 was repaired before 2 was known to be lost.
        assert_eq!(restorer.wanted([2].into_iter(), 9), 0);
        assert_eq!(restorer.wanted([5].into_iter(), 9), 1);
        assert_eq!(restorer.wanted([2, 5].into_iter(), 9), 2);
        let (last, of_both) = parity(0, &columns[2..]);
        restorer.add(last, of_both);
        assert_eq!(restorer.wanted([2].into_iter(), 9), 1);
    }

    proptest! {
        #[test]
        fn as_many_packets_come_back_as_there_are_parities(
            first in 0_u64..1_000, columns in vec(vec(any::<u8>(), 1..60), 1..PARITY_SPAN as usize),
            lost in vec(any::<prop::sample::Index>(), 1..PARITIES_KEPT), row in 0..PARITY_ROWS - 16, late in any::<bool>(),
        ) {
            let columns: Vec<_> = columns.into_iter().enumerate().map(|(n, column)| (first + n as u64, column)).collect();
            let mut lost: Vec<usize> = lost.iter().map(|index| index.index(columns.len())).collect();
            lost.sort_unstable();
            lost.dedup();
            let mut restorer = Restorer::new(first);
            let heard = |restorer: &mut Restorer| {
                for (place, (number, column)) in columns.iter().enumerate() {
                    if !lost.contains(&place) {
                        restorer.hear(*number, column);
                    }
                }
            };
            if !late {
                heard(&mut restorer);
            }
            for place in 0..lost.len() {
                prop_assert!(restorer.rebuild().is_empty());
                let (last, parity) = parity(row + place as u8, &columns);
                restorer.add(last, parity);
            }
            if late {
                heard(&mut restorer);
            }
            let rebuilt = restorer.rebuild();
            prop_assert_eq!(rebuilt.len(), lost.len());
            for (number, column) in &rebuilt {
                restorer.hear(*number, column);
            }
            for ((number, column), place) in rebuilt.iter().zip(&lost) {
                let (expected, said) = &columns[*place];
                prop_assert_eq!(number, expected);
                let bytes = column.len().max(said.len());
                prop_assert_eq!(padded(column, bytes), padded(said, bytes));
            }
            prop_assert_eq!(restorer.wanted(lost.iter().map(|place| first + *place as u64), first + columns.len() as u64), 0);
            prop_assert!(restorer.sums.is_empty());
        }

        #[test]
        fn whatever_is_heard_what_is_kept_is_bounded(
            heard in vec((any::<u16>(), any::<u32>(), 0..PARITY_ROWS, vec(any::<u8>(), 0..20), any::<bool>()), 0..200),
        ) {
            let mut restorer = Restorer::default();
            for (number, covered, row, bytes, is_parity) in heard {
                let number = u64::from(number % 300);
                if is_parity {
                    let parity = Parity { last: crate::packet::Low16::of(number), covered: covered >> 1, row, sums: bytes };
                    restorer.add(number, parity);
                } else {
                    restorer.hear(number, &bytes);
                }
                let rebuilt = restorer.rebuild();
                prop_assert!(rebuilt.len() <= PARITIES_KEPT);
                for (number, column) in rebuilt {
                    restorer.hear(number, &column);
                }
                prop_assert!(restorer.sums.len() <= PARITIES_KEPT);
                prop_assert!(restorer.wanted(0..300, 300) <= PARITY_SPAN as u8);
            }
        }
    }

    #[test]
    fn parities_over_different_packets_add_up() {
        let columns: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut restorer = Restorer::new(0);
        for place in [0, 3, 4, 7] {
            restorer.hear(columns[place].0, &columns[place].1);
        }
        for (row, covered) in [(0, 0..3), (1, 1..6), (2, 2..7), (3, 5..8)] {
            let (last, parity) = parity(row, &columns[covered]);
            restorer.add(last, parity);
        }
        let rebuilt = restorer.rebuild();
        let numbers: Vec<u64> = rebuilt.iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, [1, 2, 5, 6]);
        assert!(
            rebuilt
                .iter()
                .all(|(number, column)| *column == columns[*number as usize].1)
        );
    }

    #[test]
    fn a_parity_that_another_packet_is_lacking_for_too_saves_none() {
        let columns: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut restorer = Restorer::new(0);
        for place in [0, 1, 2, 4, 5] {
            restorer.hear(columns[place].0, &columns[place].1);
        }
        // Packet 6 is not known to be lost: nothing behind it was heard.
        let (last, sums) = parity(0, &columns[..7]);
        restorer.add(last, sums);
        assert_eq!(restorer.wanted([3].into_iter(), 6), 1);
        assert_eq!(restorer.wanted([3, 6].into_iter(), 7), 1);
        let (last, sums) = parity(1, &columns[..6]);
        restorer.add(last, sums);
        let rebuilt = restorer.rebuild();
        assert_eq!(
            rebuilt
                .iter()
                .map(|(number, _)| *number)
                .collect::<Vec<_>>(),
            [3, 6]
        );
    }

    #[test]
    fn what_was_said_before_this_began_is_not_waited_for() {
        let columns: Vec<_> = (0..4_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut restorer = Restorer::new(2);
        restorer.hear(2, &columns[2].1);
        let (last, parity) = parity(0, &columns);
        restorer.add(last, parity);
        assert!(restorer.rebuild().is_empty() && restorer.sums.is_empty());
        assert_eq!(restorer.wanted([3].into_iter(), 4), 1);
    }
}
