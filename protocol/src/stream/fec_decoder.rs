//! FEC: recovers lost packets of a stream from its repair symbols.
//!
//! Handles source symbols and sums only; the subscriber reads a recovered packet like any other. Bytes come from
//! untrusted peers. Memory is bounded by [`FEC_SPAN`] source symbols, in reused buffers, and [`REPAIR_SYMBOLS_KEPT`]
//! repair symbols. A repair symbol costs at most one multiplication for each byte of these.

use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

use crate::limits::{FEC_SPAN, REPAIR_SYMBOLS_KEPT};
use crate::packet::{
    Datagram, LargestPacket, RepairSymbol, add_times, inverse, source_symbol_into, times,
};

/// A repair symbol minus the source symbols of received packets.
#[derive(Clone, Debug)]
struct PartialSum {
    row: u8,
    /// The packets still in the sum.
    unknown: Vec<u64>,
    source_symbol: Vec<u8>,
}

impl PartialSum {
    /// Subtracts the source symbol of a packet that became known.
    fn take(&mut self, number: u64, source_symbol: &[u8]) {
        let Some(place) = self.unknown.iter().position(|other| *other == number) else {
            return;
        };
        // In order, so that equal sums compare equal.
        self.unknown.remove(place);
        if self.source_symbol.len() < source_symbol.len() {
            self.source_symbol.resize(source_symbol.len(), 0);
        }
        add_times(
            &mut self.source_symbol,
            RepairSymbol::factor(self.row, number),
            source_symbol,
        );
    }
}

/// The source symbols of recent packets, and repair symbols that cannot be used yet.
#[derive(Clone, Debug, Default)]
pub(crate) struct FecDecoder {
    /// One more than the highest number received, in a packet or in a repair symbol.
    end: u64,
    source_symbols: SourceSymbols,
    /// The source symbol of the packet being received.
    received: Vec<u8>,
    sums: VecDeque<PartialSum>,
    /// No packet below this number is recovered: it was sent before the start, or a repair symbol was wrong.
    usable_from: u64,
}

impl FecDecoder {
    /// A decoder of a stream whose first packet has the number `next`.
    pub(crate) fn new(next: u64, largest_packet: LargestPacket) -> Self {
        Self {
            source_symbols: SourceSymbols::new(largest_packet),
            end: next,
            usable_from: next,
            ..Self::default()
        }
    }

    /// Adds a received packet.
    pub(crate) fn add_packet(&mut self, number: u64, datagram: &Datagram<'_>) {
        let mut source_symbol = core::mem::take(&mut self.received);
        if source_symbol_into(datagram, &mut source_symbol).is_some() {
            self.add_known(number, &source_symbol);
        }
        self.received = source_symbol;
    }

    /// Adds the source symbol of a received or recovered packet.
    pub(crate) fn add_known(&mut self, number: u64, source_symbol: &[u8]) {
        self.advance(number + 1);
        if number < self.oldest() {
            return;
        }
        for sum in &mut self.sums {
            sum.take(number, source_symbol);
        }
        self.sums.retain(|sum| !sum.unknown.is_empty());
        self.source_symbols.keep(number, source_symbol);
    }

    /// Adds a received repair symbol; `last` is the full number of its newest packet.
    pub(crate) fn add(&mut self, last: u64, repair_symbol: RepairSymbol) {
        self.advance(last + 1);
        let mut sum = PartialSum {
            row: repair_symbol.row,
            unknown: repair_symbol.numbers(last).collect(),
            source_symbol: repair_symbol.sums,
        };
        for number in sum.unknown.clone() {
            if let Some(source_symbol) = self.source_symbols.get(number) {
                sum.take(number, source_symbol);
            }
        }
        let oldest = self.oldest().max(self.usable_from);
        let of_use = sum.unknown.iter().all(|number| *number >= oldest);
        let twice = |other: &PartialSum| other.row == sum.row && other.unknown == sum.unknown;
        if !of_use || sum.unknown.is_empty() || self.sums.iter().any(twice) {
            return;
        }
        if self.sums.len() == REPAIR_SYMBOLS_KEPT {
            self.sums.pop_front();
        }
        self.sums.push_back(sum);
    }

    /// The packets that can be recovered now, in order of number, with their source symbols. Returns them again until
    /// they are added as known.
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

    /// Handles a recovered packet that is malformed: drops all repair symbols received so far, and uses none that lacks
    /// a packet sent so far.
    pub(crate) fn drop_repair_symbols(&mut self, number: u64) {
        self.source_symbols.forget(number);
        self.sums.clear();
        self.usable_from = self.end;
    }

    /// The source symbol of a recent packet that was received or recovered.
    pub(crate) fn source_symbol(&self, number: u64) -> Option<&[u8]> {
        self.source_symbols.get(number)
    }

    /// The number of further repair symbols that would recover the missing packets below `next`; zero where fewer
    /// refreshes suffice.
    ///
    /// A requested repair symbol covers all packets since the oldest missing one. That includes packets that were
    /// refreshed: their content is known, but not their bytes. So more repair symbols are needed than packets are
    /// missing, and they must fit the memory.
    pub(crate) fn wanted(&self, missing: impl Iterator<Item = u64>, next: u64) -> u8 {
        let oldest = next
            .saturating_sub(u64::from(FEC_SPAN))
            .max(self.usable_from);
        let is_lacking = |number: &u64| self.source_symbols.get(*number).is_none();
        if (oldest..next).filter(is_lacking).count() > REPAIR_SYMBOLS_KEPT {
            return 0;
        }
        let of_use = |number: &u64| *number >= oldest && is_lacking(number);
        let lost: Vec<u64> = missing.filter(of_use).collect();
        let Some(first) = lost.first() else {
            return 0;
        };
        let covered: Vec<u64> = (*first..next).filter(is_lacking).collect();
        // Packets outside the request come first, so that the rows after them do not contain these packets.
        let mut unknown = self.unknown();
        unknown.retain(|number| covered.binary_search(number).is_err());
        let others = unknown.len();
        unknown.extend(&covered);
        let rows = self.reduced(&unknown);
        let is_of_covered = |row: &&Equation| {
            let (others, covered) = row.factors.split_at(others);
            others.iter().all(|factor| *factor == 0) && covered.iter().any(|factor| *factor != 0)
        };
        let wanted = covered.len() - rows.iter().filter(is_of_covered).count();
        if wanted > lost.len() {
            return 0;
        }
        wanted as u8
    }

    /// Moves the window on: packets below `end` are known to exist, and those below the window are dropped.
    fn advance(&mut self, end: u64) {
        if end <= self.end {
            return;
        }
        self.end = end;
        let oldest = self.oldest();
        self.source_symbols.forget_below(oldest);
        let of_use = |sum: &PartialSum| sum.unknown.iter().all(|number| *number >= oldest);
        self.sums.retain(of_use);
    }

    const fn oldest(&self) -> u64 {
        self.end.saturating_sub(FEC_SPAN as u64)
    }

    /// The packets in any sum, in order of number.
    fn unknown(&self) -> Vec<u64> {
        let all = self.sums.iter();
        let mut unknown: Vec<u64> = all.flat_map(|sum| sum.unknown.iter().copied()).collect();
        unknown.sort_unstable();
        unknown.dedup();
        unknown
    }

    /// The sums as reduced equations in these packets, each solved for its first packet.
    fn reduced(&self, unknown: &[u64]) -> Vec<Equation> {
        let rows = 0..self.sums.len();
        let mut rows: Vec<Equation> = rows.map(|place| self.row(place, unknown)).collect();
        reduce(&mut rows, unknown.len());
        rows
    }

    fn row(&self, place: usize, unknown: &[u64]) -> Equation {
        let sum = &self.sums[place];
        let factor = |number: &u64| {
            let covered = sum.unknown.contains(number);
            if covered {
                RepairSymbol::factor(sum.row, *number)
            } else {
                0
            }
        };
        let mut shares = vec![0; self.sums.len()];
        shares[place] = 1;
        Equation {
            factors: unknown.iter().map(factor).collect(),
            shares,
        }
    }

    /// The sum of the repair symbols, weighted by their shares in a row.
    fn mixed(&self, row: &Equation) -> Vec<u8> {
        let used = || {
            self.sums
                .iter()
                .zip(&row.shares)
                .filter(|(_, share)| **share != 0)
        };
        let longest = used().map(|(sum, _)| sum.source_symbol.len()).max();
        let mut source_symbol = vec![0; longest.unwrap_or_default()];
        for (sum, share) in used() {
            add_times(&mut source_symbol, *share, &sum.source_symbol);
        }
        source_symbol
    }
}

/// A linear equation: the coefficients of the unknown packets, and the weights of the repair symbols that it combines.
#[derive(Clone, Debug)]
struct Equation {
    factors: Vec<u8>,
    shares: Vec<u8>,
}

impl Equation {
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

/// Gauss-Jordan elimination: afterwards the first coefficient of each row is one, and zero in all other rows.
fn reduce(rows: &mut [Equation], source_symbols: usize) {
    let mut done = 0;
    for source_symbol in 0..source_symbols {
        let Some(found) = (done..rows.len()).find(|place| rows[*place].factors[source_symbol] != 0)
        else {
            continue;
        };
        rows.swap(done, found);
        let factor = rows[done].factors[source_symbol];
        rows[done].scale(inverse(factor));
        let pivot = rows[done].clone();
        for (place, row) in rows.iter_mut().enumerate() {
            if place != done {
                let factor = row.factors[source_symbol];
                row.add(factor, &pivot);
            }
        }
        done += 1;
    }
}

/// Source symbols by number.
#[derive(Clone, Debug, Default)]
struct SourceSymbols {
    largest_packet: LargestPacket,
    /// Empty until the first symbol is kept; then one slot for each number of the span.
    places: Vec<SymbolSlot>,
}

#[derive(Clone, Debug, Default)]
struct SymbolSlot {
    /// The number of the packet; None for an empty slot.
    number: Option<u64>,
    source_symbol: Vec<u8>,
}

impl SourceSymbols {
    /// No symbols yet, of a stream with packets of at most this size.
    fn new(largest_packet: LargestPacket) -> Self {
        Self {
            largest_packet,
            places: Vec::new(),
        }
    }

    /// Keeps the source symbol of a packet.
    fn keep(&mut self, number: u64, source_symbol: &[u8]) {
        if self.places.is_empty() {
            self.places.resize(FEC_SPAN as usize, SymbolSlot::default());
        }
        let place = &mut self.places[place_of(number)];
        place.number = Some(number);
        place.source_symbol.clear();
        // Reserves the longest symbol at once, so that a longer one never reallocates.
        let longest = self.largest_packet.bytes();
        place.source_symbol.reserve_exact(longest);
        place.source_symbol.extend_from_slice(source_symbol);
    }

    /// Drops the source symbol of a packet.
    fn forget(&mut self, number: u64) {
        if self.get(number).is_some() {
            self.places[place_of(number)].number = None;
        }
    }

    /// Drops the source symbols of all packets below this number.
    fn forget_below(&mut self, oldest: u64) {
        for place in &mut self.places {
            place.number = place.number.filter(|number| *number >= oldest);
        }
    }

    /// The source symbol of a packet, if it is kept.
    fn get(&self, number: u64) -> Option<&[u8]> {
        let place = self.places.get(place_of(number))?;
        (place.number == Some(number)).then_some(&place.source_symbol)
    }
}

const fn place_of(number: u64) -> usize {
    (number % FEC_SPAN as u64) as usize
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;
    use crate::limits::FEC_ROWS;

    /// A repair symbol of this row over source symbols with rising numbers.
    fn repair_symbol(row: u8, source_symbols: &[(u64, Vec<u8>)]) -> (u64, RepairSymbol) {
        let (last, _) = source_symbols[source_symbols.len() - 1];
        let mut repair_symbol = RepairSymbol::begin(row, last);
        for (number, source_symbol) in source_symbols {
            repair_symbol.add(*number, last - number, source_symbol);
        }
        (last, repair_symbol)
    }

    fn padded(source_symbol: &[u8], bytes: usize) -> Vec<u8> {
        let mut source_symbol = source_symbol.to_vec();
        source_symbol.resize(bytes.max(source_symbol.len()), 0);
        source_symbol
    }

    #[test]
    fn too_many_losses_request_no_repair_symbols() {
        let lacking = |received: u64| {
            let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
            (0..received).for_each(|number| fec_decoder.add_known(number, &[1]));
            // All packets but the last were refreshed.
            fec_decoder.wanted(core::iter::once(31), 32)
        };
        assert_eq!(lacking(32 - REPAIR_SYMBOLS_KEPT as u64), 1);
        assert_eq!(lacking(31 - REPAIR_SYMBOLS_KEPT as u64), 0);
    }

    #[test]
    fn repair_symbols_after_a_loss_reduce_the_request() {
        let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
        let source_symbols: Vec<_> = (0..9).map(|number| (number, vec![number as u8])).collect();
        let received = [0, 1, 3, 4, 6, 7, 8];
        received
            .iter()
            .for_each(|number| fec_decoder.add_known(*number, &[*number as u8]));
        // Packet 5 was refreshed before packet 2 was known to be lost.
        assert_eq!(fec_decoder.wanted([2].into_iter(), 9), 0);
        assert_eq!(fec_decoder.wanted([5].into_iter(), 9), 1);
        assert_eq!(fec_decoder.wanted([2, 5].into_iter(), 9), 2);
        let (last, of_both) = repair_symbol(0, &source_symbols[2..]);
        fec_decoder.add(last, of_both);
        assert_eq!(fec_decoder.wanted([2].into_iter(), 9), 1);
    }

    proptest! {
        #[test]
        fn each_repair_symbol_recovers_one_lost_packet(
            first in 0_u64..1_000, source_symbols in vec(vec(any::<u8>(), 1..60), 1..FEC_SPAN as usize),
            lost in vec(any::<prop::sample::Index>(), 1..REPAIR_SYMBOLS_KEPT), row in 0..FEC_ROWS - 16, late in any::<bool>(),
        ) {
            let source_symbols: Vec<_> = source_symbols.into_iter().enumerate().map(|(n, source_symbol)| (first + n as u64, source_symbol)).collect();
            let mut lost: Vec<usize> = lost.iter().map(|index| index.index(source_symbols.len())).collect();
            lost.sort_unstable();
            lost.dedup();
            let mut fec_decoder = FecDecoder::new(first, LargestPacket::DEFAULT);
            let received = |fec_decoder: &mut FecDecoder| {
                for (place, (number, source_symbol)) in source_symbols.iter().enumerate() {
                    if !lost.contains(&place) {
                        fec_decoder.add_known(*number, source_symbol);
                    }
                }
            };
            if !late {
                received(&mut fec_decoder);
            }
            for place in 0..lost.len() {
                prop_assert!(fec_decoder.rebuild().is_empty());
                let (last, repair_symbol) = repair_symbol(row + place as u8, &source_symbols);
                fec_decoder.add(last, repair_symbol);
            }
            if late {
                received(&mut fec_decoder);
            }
            let rebuilt = fec_decoder.rebuild();
            prop_assert_eq!(rebuilt.len(), lost.len());
            for (number, source_symbol) in &rebuilt {
                fec_decoder.add_known(*number, source_symbol);
            }
            for ((number, source_symbol), place) in rebuilt.iter().zip(&lost) {
                let (expected, original) = &source_symbols[*place];
                prop_assert_eq!(number, expected);
                let bytes = source_symbol.len().max(original.len());
                prop_assert_eq!(padded(source_symbol, bytes), padded(original, bytes));
            }
            prop_assert_eq!(fec_decoder.wanted(lost.iter().map(|place| first + *place as u64), first + source_symbols.len() as u64), 0);
            prop_assert!(fec_decoder.sums.is_empty());
        }

        #[test]
        fn decoder_memory_is_bounded(
            received in vec((any::<u16>(), any::<u32>(), 0..FEC_ROWS, vec(any::<u8>(), 0..20), any::<bool>()), 0..200),
        ) {
            let mut fec_decoder = FecDecoder::default();
            for (number, covered, row, bytes, is_repair_symbol) in received {
                let number = u64::from(number % 300);
                if is_repair_symbol {
                    let repair_symbol = RepairSymbol { last: crate::packet::Low16::of(number), covered: covered >> 1, row, sums: bytes };
                    fec_decoder.add(number, repair_symbol);
                } else {
                    fec_decoder.add_known(number, &bytes);
                }
                let rebuilt = fec_decoder.rebuild();
                prop_assert!(rebuilt.len() <= REPAIR_SYMBOLS_KEPT);
                for (number, source_symbol) in rebuilt {
                    fec_decoder.add_known(number, &source_symbol);
                }
                prop_assert!(fec_decoder.sums.len() <= REPAIR_SYMBOLS_KEPT);
                prop_assert!(fec_decoder.wanted(0..300, 300) <= FEC_SPAN as u8);
            }
        }
    }

    #[test]
    fn repair_symbols_over_different_packets_combine() {
        let source_symbols: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
        for place in [0, 3, 4, 7] {
            fec_decoder.add_known(source_symbols[place].0, &source_symbols[place].1);
        }
        for (row, covered) in [(0, 0..3), (1, 1..6), (2, 2..7), (3, 5..8)] {
            let (last, repair_symbol) = repair_symbol(row, &source_symbols[covered]);
            fec_decoder.add(last, repair_symbol);
        }
        let rebuilt = fec_decoder.rebuild();
        let numbers: Vec<u64> = rebuilt.iter().map(|(number, _)| *number).collect();
        assert_eq!(numbers, [1, 2, 5, 6]);
        assert!(
            rebuilt
                .iter()
                .all(|(number, source_symbol)| *source_symbol == source_symbols[*number as usize].1)
        );
    }

    #[test]
    fn a_repair_symbol_with_another_unknown_packet_does_not_reduce_the_request() {
        let source_symbols: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
        for place in [0, 1, 2, 4, 5] {
            fec_decoder.add_known(source_symbols[place].0, &source_symbols[place].1);
        }
        // Packet 6 is not known to be lost, because no later packet was received.
        let (last, sums) = repair_symbol(0, &source_symbols[..7]);
        fec_decoder.add(last, sums);
        assert_eq!(fec_decoder.wanted([3].into_iter(), 6), 1);
        assert_eq!(fec_decoder.wanted([3, 6].into_iter(), 7), 1);
        let (last, sums) = repair_symbol(1, &source_symbols[..6]);
        fec_decoder.add(last, sums);
        let rebuilt = fec_decoder.rebuild();
        assert_eq!(
            rebuilt
                .iter()
                .map(|(number, _)| *number)
                .collect::<Vec<_>>(),
            [3, 6]
        );
    }

    #[test]
    fn packets_before_the_start_are_ignored() {
        let source_symbols: Vec<_> = (0..4_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
        let mut fec_decoder = FecDecoder::new(2, LargestPacket::DEFAULT);
        fec_decoder.add_known(2, &source_symbols[2].1);
        let (last, repair_symbol) = repair_symbol(0, &source_symbols);
        fec_decoder.add(last, repair_symbol);
        assert!(fec_decoder.rebuild().is_empty() && fec_decoder.sums.is_empty());
        assert_eq!(fec_decoder.wanted([3].into_iter(), 4), 1);
    }

    #[test]
    fn a_source_symbol_is_kept_until_it_is_dropped_or_replaced() {
        let span = u64::from(FEC_SPAN);
        let mut source_symbols = SourceSymbols::default();
        assert_eq!(source_symbols.get(7), None);
        source_symbols.keep(7, &[1, 2, 3]);
        source_symbols.keep(8, &[4]);
        assert_eq!(source_symbols.get(7), Some(&[1, 2, 3][..]));
        assert_eq!(source_symbols.get(7 + span), None);
        source_symbols.keep(7 + span, &[5]);
        assert_eq!(
            (source_symbols.get(7), source_symbols.get(7 + span)),
            (None, Some(&[5][..]))
        );
        source_symbols.forget(7);
        assert_eq!(source_symbols.get(7 + span), Some(&[5][..]));
        source_symbols.forget_below(9);
        assert_eq!(
            (source_symbols.get(8), source_symbols.get(7 + span)),
            (None, Some(&[5][..]))
        );
        source_symbols.forget(7 + span);
        assert_eq!(source_symbols.get(7 + span), None);
    }
}
