//! The parities of a stream at its source: over what, and when they are said
//!
//! Knows nothing of who listens but how much is lost. Keeps the packets of [`PARITY_SPAN`] numbers.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;

use super::redundancy::Redundancy;
use crate::limits::{PARITIES_KEPT, PARITY_ROWS, PARITY_SPAN};
use crate::packet::{Parity, StreamId, column_of};

/// A parity covers so many packets at most if nobody asked for it: as many as two bytes can name.
const COVERED: u64 = 15;

/// A parity covers what only one did before again, if that is longer than the newest packets by up to this share: a third.
/// Measured on recorded cubes at 5 %: however long takes 1.4 kbit/s more for a thirtieth less that is off, a tenth loses a
/// quarter more.
const LONGER: usize = 3;

/// A parity that was said.
#[derive(Clone, Debug)]
struct Said {
    /// Packets had been sent below this number.
    end: u64,
    numbers: Vec<u64>,
    datagram: Bytes,
}

/// A parity that somebody asked for, and so may serve others who ask.
#[derive(Clone, Debug)]
struct Asked {
    said: Said,
    /// How often it was given.
    askers: u32,
    /// What who was given it last had lost: who asks the same again has had it, or it was lost too.
    last: Vec<u64>,
}

/// Who asks for what it lost, as far as its source knows it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asker {
    /// It has heard of packets below this number.
    pub(crate) heard: u64,
    /// Parities that it wants.
    pub(crate) wanted: usize,
    /// It was sent the parities that nobody asked for, of those that were said when packets beyond this number had been.
    pub(crate) sent_from: u64,
}

/// A parity that was asked for is given so often at most, so that nobody is given the same for ever.
const ASKERS_MAX: u32 = 4;

/// The last packets of a stream and what is said of them once more.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parities {
    next: u64,
    /// The columns of the packets below `next`, oldest first; empty of those that cannot be rebuilt.
    columns: VecDeque<Vec<u8>>,
    /// The first packet that no parity covers yet, and the first that one parity covers at most: every packet is in two.
    uncovered: u64,
    covered_once: u64,
    /// Whether the packets of the present tick are halves of one.
    halved: bool,
    redundancy: Redundancy,
    /// For how many ticks that one has waited.
    waited: u32,
    row: u8,
    /// Parities over packets that are kept.
    said: VecDeque<Said>,
    /// Parities that were asked for since the last tick, the newest of them.
    asked: VecDeque<Asked>,
}

impl Parities {
    /// A packet was said.
    pub(crate) fn record(&mut self, number: u64, datagram: &[u8]) {
        if self.columns.len() == PARITY_SPAN as usize {
            self.columns.pop_front();
        }
        let column = column_of(datagram).map(|(_, column)| column);
        self.columns.push_back(column.unwrap_or_default());
        self.next = number + 1;
    }

    /// A tick was spoken of: says what parities are due and appends them to `out`.
    pub(crate) fn end_tick(
        &mut self,
        stream: StreamId,
        redundancy: Redundancy,
        out: &mut Vec<Bytes>,
    ) {
        self.asked.clear();
        self.redundancy = redundancy;
        let halved = core::mem::take(&mut self.halved);
        let oldest = self.oldest();
        self.said.retain(|said| said.end > oldest);
        let Some(ticks) = redundancy.ticks() else {
            (self.uncovered, self.covered_once) = (self.next, self.next);
            self.waited = 0;
            return;
        };
        self.uncovered = self.uncovered.max(oldest);
        self.covered_once = self.covered_once.max(oldest);
        if self.uncovered == self.next {
            return;
        }
        self.waited += 1;
        if self.waited < ticks && !halved {
            return;
        }
        self.waited = 0;
        while self.uncovered < self.next {
            let end = self.next.min(self.uncovered + COVERED);
            let from = (end.saturating_sub(COVERED)).max(oldest);
            let longest_of = |numbers: core::ops::Range<u64>, most: usize| {
                let lengths = numbers.map(|number| self.column(number).len());
                lengths
                    .filter(|bytes| *bytes <= most)
                    .max()
                    .unwrap_or_default()
            };
            let fresh = longest_of(self.uncovered..end, usize::MAX);
            let owed = self.covered_once.max(from)..end;
            let longest = longest_of(owed, fresh + fresh / LONGER);
            let numbers =
                (from..end).filter(|number| (1..=longest).contains(&self.column(*number).len()));
            let numbers: Vec<u64> = numbers.collect();
            for _ in 0..redundancy.parities(end - self.uncovered) {
                if let Some(said) = self.say(stream, &numbers) {
                    out.push(said.datagram.clone());
                    self.said.push_back(said);
                }
            }
            (self.covered_once, self.uncovered) = (self.uncovered, end);
        }
    }

    /// Whether a tick that takes so many bytes is to be said in two packets.
    pub(crate) const fn halves(&self, bytes: usize) -> bool {
        self.redundancy.halves(bytes)
    }

    /// The packets of the present tick are halves of one.
    pub(crate) const fn halve(&mut self) {
        self.halved = true;
    }

    /// What to say to who lost some packets and wants parities, beside those that are under way to it. Appends to `out`,
    /// and returns which of the lost packets must be repaired.
    pub(crate) fn answer(
        &mut self,
        stream: StreamId,
        lost: impl Iterator<Item = u64>,
        asker: Asker,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let Asker { heard, wanted, .. } = asker;
        let (recent, old): (Vec<u64>, Vec<u64>) =
            lost.partition(|number| wanted > 0 && !self.column(*number).is_empty());
        if recent.is_empty() {
            return old;
        }
        let of_use = |said: &Said| said.numbers.iter().any(|number| recent.contains(number));
        let unheard = heard.max(asker.sent_from);
        let under_way = self
            .said
            .iter()
            .filter(|said| said.end > unheard && of_use(said));
        let wanted = wanted.min(recent.len());
        let mut wanted = self.redundancy.answers(wanted, under_way.count());
        // One serves all who lost what it covers, but for who had it and asks again.
        for asked in &mut self.asked {
            let said = &asked.said;
            let serves =
                recent.iter().all(|number| said.numbers.contains(number)) && said.end <= heard;
            if wanted > 0 && serves && asked.askers < ASKERS_MAX && asked.last != recent {
                out.push(said.datagram.clone());
                wanted -= 1;
                asked.askers += 1;
                asked.last.clone_from(&recent);
            }
        }
        let longest = recent.iter().map(|number| self.column(*number).len()).max();
        let from = recent.iter().copied().min().unwrap_or(heard);
        let numbers = (from..self.next.min(heard)).filter(|number| {
            let bytes = self.column(*number).len();
            bytes > 0 && Some(bytes) <= longest
        });
        let numbers: Vec<u64> = numbers.collect();
        for _ in 0..wanted {
            if let Some(said) = self.say(stream, &numbers) {
                out.push(said.datagram.clone());
                if self.asked.len() == PARITIES_KEPT {
                    self.asked.pop_front();
                }
                self.asked.push_back(Asked {
                    said: Said { end: heard, ..said },
                    askers: 1,
                    last: recent.clone(),
                });
            }
        }
        old
    }

    /// Sums over packets with factors that were not used lately; `None` if there are no packets.
    fn say(&mut self, stream: StreamId, numbers: &[u64]) -> Option<Said> {
        let last = *numbers.last()?;
        let mut parity = Parity::begin(self.row, last);
        for number in numbers {
            parity.add(*number, last - number, self.column(*number));
        }
        self.row = (self.row + 1) % PARITY_ROWS;
        Some(Said {
            end: self.next,
            numbers: numbers.to_vec(),
            datagram: Bytes::from(parity.encode(stream)),
        })
    }

    fn oldest(&self) -> u64 {
        self.next - self.columns.len() as u64
    }

    fn column(&self, number: u64) -> &[u8] {
        let place = number.checked_sub(self.oldest());
        let column = place.and_then(|place| self.columns.get(place as usize));
        column.map_or(&[], Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{Head, Kind};
    use crate::wire::Wire;
    use crate::wire::bytes::Reader;
    use alloc::vec;

    const STREAM: StreamId = StreamId(3);

    /// A state packet of so many bytes.
    fn packet(number: u64, bytes: usize) -> Vec<u8> {
        let mut packet = vec![1, 3];
        packet.extend_from_slice(&(number as u16).to_le_bytes());
        packet.resize(bytes, 7);
        packet
    }

    /// Who has heard of packets below a number, and wants so many parities beside all that were said since.
    const fn asker(heard: u64, wanted: usize) -> Asker {
        Asker {
            heard,
            wanted,
            sent_from: 0,
        }
    }

    fn covered(datagram: &[u8]) -> Vec<u64> {
        let mut reader = Reader::new(datagram);
        assert_eq!(
            Head::decode(&mut reader).map(|head| head.kind),
            Ok(Kind::Parity)
        );
        let parity = Parity::decode(reader).expect("a parity was said");
        let mut numbers: Vec<u64> = parity.numbers(parity.last.expand(0)).collect();
        numbers.reverse();
        numbers
    }

    /// Ten packets, one a tick, with what was said of them.
    fn ten(redundancy: Redundancy) -> (Parities, Vec<Vec<u64>>) {
        let mut parities = Parities::default();
        let mut said = Vec::new();
        for number in 0..10 {
            parities.record(number, &packet(number, 40));
            parities.end_tick(STREAM, redundancy, &mut said);
        }
        (
            parities,
            said.iter().map(|datagram| covered(datagram)).collect(),
        )
    }

    #[test]
    fn each_packet_is_covered_soon_and_again_by_what_follows() {
        let (_, said) = ten(Redundancy::Plain);
        let ends: Vec<_> = said
            .iter()
            .map(|numbers| numbers[numbers.len() - 1])
            .collect();
        assert_eq!(ends, [1, 3, 5, 7, 9]);
        assert_eq!(said[4], (0..10).collect::<Vec<_>>());
        assert_eq!(ten(Redundancy::Off).1, [[0; 0]; 0]);
    }

    #[test]
    fn a_packet_is_covered_twice_unless_it_is_much_longer_than_what_follows() {
        for (bytes, times) in [(50, 2), (90, 1)] {
            let mut parities = Parities::default();
            let mut said = Vec::new();
            for number in 0..8 {
                let bytes = if number == 3 { bytes } else { 40 };
                parities.record(number, &packet(number, bytes));
                parities.end_tick(STREAM, Redundancy::Plain, &mut said);
            }
            let said: Vec<_> = said.iter().map(|datagram| covered(datagram)).collect();
            let of_the_long_one = said.iter().filter(|numbers| numbers.contains(&3));
            assert_eq!(of_the_long_one.count(), times);
            assert_eq!(said[3], [0, 1, 2, 4, 5, 6, 7]);
        }
    }

    #[test]
    fn a_tick_in_halves_has_a_parity_of_its_own() {
        let mut parities = Parities::default();
        let mut said = Vec::new();
        for tick in 0..6 {
            for half in 0..2 {
                parities.record(2 * tick + half, &packet(2 * tick + half, 100));
            }
            parities.halve();
            parities.end_tick(STREAM, Redundancy::Plain, &mut said);
        }
        let said: Vec<_> = said.iter().map(|datagram| covered(datagram)).collect();
        assert_eq!(said.len(), 6);
        assert!(
            said.iter()
                .zip(1..)
                .all(|(numbers, ticks)| numbers.ends_with(&[2 * ticks - 2, 2 * ticks - 1]))
        );
    }

    #[test]
    fn who_asks_gets_what_is_not_under_way() {
        let (mut parities, _) = ten(Redundancy::Plain);
        let mut out = Vec::new();
        // The parities of packets 7 and 9 are under way to who has heard of packets below 6.
        let old = parities.answer(STREAM, [3, 4, 5].into_iter(), asker(6, 3), &mut out);
        assert!(old.is_empty());
        let said: Vec<_> = out.iter().map(|datagram| covered(datagram)).collect();
        // One would do if none were lost; with two, one time of seventy too few would arrive.
        assert_eq!(said, [[3, 4, 5], [3, 4, 5], [3, 4, 5]]);
    }

    #[test]
    fn what_others_were_sent_is_not_under_way_to_who_was_not() {
        let (parities, _) = ten(Redundancy::Plain);
        // Parities of packets 7 and 9 were said since; this many are said to who was sent none, one, and both of them.
        for (sent_from, answers) in [(u64::MAX, 2), (10, 2), (8, 1), (6, 0), (0, 0)] {
            let mut out = Vec::new();
            let asker = Asker {
                sent_from,
                ..asker(6, 1)
            };
            let old = parities
                .clone()
                .answer(STREAM, [5].into_iter(), asker, &mut out);
            assert!(old.is_empty());
            assert_eq!(out.len(), answers, "{sent_from}");
        }
    }

    #[test]
    fn one_parity_serves_all_who_ask_in_a_tick() {
        let (mut parities, _) = ten(Redundancy::Off);
        let mut out = Vec::new();
        for lost in [2, 3, 5] {
            assert!(
                parities
                    .answer(STREAM, [lost].into_iter(), asker(10, 1), &mut out)
                    .is_empty()
            );
        }
        // Each time the same two: one of them may be lost.
        assert_eq!(out.len(), 6);
        assert!(out.chunks(2).all(|said| said == &out[..2]));
        assert_ne!(out[0], out[1]);
        assert_eq!(covered(&out[0]), (2..10).collect::<Vec<_>>());
    }

    #[test]
    fn what_is_forgotten_or_not_wanted_is_repaired() {
        let mut parities = Parities::default();
        for number in 0..100 {
            parities.record(number, &packet(number, 40));
        }
        let mut out = Vec::new();
        assert_eq!(
            parities.answer(STREAM, [3, 99].into_iter(), asker(100, 1), &mut out),
            [3]
        );
        assert_eq!(out.len(), 2);
        assert_eq!(
            parities.answer(STREAM, [3, 99].into_iter(), asker(100, 0), &mut out),
            [3, 99]
        );
        assert_eq!(out.len(), 2);
        assert_eq!(parities.columns.len(), PARITY_SPAN as usize);
    }

    #[test]
    fn who_asks_the_same_again_is_given_another_parity() {
        let (mut parities, _) = ten(Redundancy::Off);
        let mut said = Vec::new();
        for _ in 0..50 {
            // Two listeners in turn, and no tick between.
            for lost in [3, 4] {
                parities.answer(STREAM, [lost].into_iter(), asker(10, 1), &mut said);
            }
        }
        assert_eq!(said.len(), 200);
        for datagram in &said {
            let given = said.iter().filter(|other| *other == datagram).count();
            assert!(given <= ASKERS_MAX as usize, "{given}");
        }
        assert!(parities.asked.len() <= PARITIES_KEPT);
    }
}
