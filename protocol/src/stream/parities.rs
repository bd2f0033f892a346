//! The parities of a stream at its source: over which packets they are summed, and when they are said.
//!
//! Knows nothing of who listens but how much is lost. Keeps the packets of [`PARITY_SPAN`] numbers.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;

use super::redundancy::Redundancy;
use crate::limits::{PARITY_ROWS, PARITY_SPAN};
use crate::packet::{Parity, StreamId, column_of};

/// A parity covers so many packets at most if nobody asked for it: as many as two bytes can name.
const COVERED: u64 = 15;
/// A parity covers older packets too if they are longer by up to this share of the newest ones: a tenth. Measured on
/// recorded cubes: none costs half of what losses of two packets in a row need, a third costs 3 % of all bytes.
const LONGER: usize = 10;

/// A parity that was said.
#[derive(Clone, Debug)]
struct Said {
    /// Packets had been sent below this number.
    end: u64,
    numbers: Vec<u64>,
    datagram: Bytes,
}

/// The last packets of a stream and what is said of them once more.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parities {
    next: u64,
    /// The columns of the packets below `next`, oldest first; empty of those that cannot be rebuilt.
    columns: VecDeque<Vec<u8>>,
    /// The first packet that no parity covers yet.
    uncovered: u64,
    /// For how many ticks that one has waited.
    waited: u32,
    row: u8,
    /// Parities over packets that are kept.
    said: VecDeque<Said>,
    /// Parities that were asked for since the last tick, and so may serve others who ask.
    asked: Vec<Said>,
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
    pub(crate) fn end_tick(&mut self, stream: StreamId, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        self.asked.clear();
        let oldest = self.oldest();
        self.said.retain(|said| said.end > oldest);
        let Some(ticks) = redundancy.ticks() else {
            self.uncovered = self.next;
            self.waited = 0;
            return;
        };
        self.uncovered = self.uncovered.max(oldest);
        if self.uncovered == self.next {
            return;
        }
        self.waited += 1;
        if self.waited < ticks {
            return;
        }
        self.waited = 0;
        while self.uncovered < self.next {
            let end = self.next.min(self.uncovered + COVERED);
            let fresh = self.uncovered..end;
            let longest = fresh.clone().map(|number| self.column(number).len()).max();
            let longest = longest.unwrap_or_default();
            let most = longest + longest / LONGER;
            let from = (end.saturating_sub(COVERED)).max(oldest);
            let numbers = (from..end).filter(|number| (1..=most).contains(&self.column(*number).len()));
            let numbers: Vec<u64> = numbers.collect();
            for _ in 0..redundancy.parities(end - self.uncovered) {
                if let Some(said) = self.say(stream, &numbers) {
                    out.push(said.datagram.clone());
                    self.said.push_back(said);
                }
            }
            self.uncovered = end;
        }
    }

    /// What to say to who lost some packets and wants so many parities, beside those that are under way to it: it has
    /// heard of packets below `heard`. Appends to `out`, and returns which of the lost packets must be repaired.
    pub(crate) fn answer(
        &mut self,
        stream: StreamId,
        lost: impl Iterator<Item = u64>,
        (heard, wanted): (u64, usize),
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let (recent, old): (Vec<u64>, Vec<u64>) =
            lost.partition(|number| wanted > 0 && !self.column(*number).is_empty());
        if recent.is_empty() {
            return old;
        }
        let of_use = |said: &Said| said.numbers.iter().any(|number| recent.contains(number));
        let under_way = self.said.iter().filter(|said| said.end > heard && of_use(said));
        let mut wanted = wanted.min(recent.len()).saturating_sub(under_way.count());
        // One serves all who lost what it covers.
        for said in &self.asked {
            let serves = recent.iter().all(|number| said.numbers.contains(number)) && said.end <= heard;
            if wanted > 0 && serves {
                out.push(said.datagram.clone());
                wanted -= 1;
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
                self.asked.push(Said { end: heard, ..said });
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
