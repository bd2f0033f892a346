//! FEC: repair symbols of a stream, and recovery of lost packets from them.
//!
//! The encoder knows of the receivers only how many packets they lose. The decoder handles source symbols and sums only; the
//! subscriber reads a recovered packet like any other. Bytes come from untrusted peers. Memory of each is bounded by
//! [`FEC_SPAN`] source symbols, in reused buffers, and [`REPAIR_SYMBOLS_KEPT`] repair symbols. A repair symbol costs at most
//! one multiplication for each byte of these.

use alloc::collections::VecDeque;
use alloc::vec;
use alloc::vec::Vec;

use bytes::Bytes;

use super::Redundancy;
use crate::limits::{FEC_ROWS, FEC_SPAN, REPAIR_SYMBOLS_KEPT};
use crate::packet::{
    Datagram, LargestPacket, RepairSymbol, StreamId, add_times, inverse, source_symbol_into,
    source_symbol_of, times,
};

/// The most packets that an unrequested repair symbol covers: the number that two bytes of the header can name.
const COVERED: u64 = 15;

/// A repair symbol covers packets a second time if the longest of them exceeds the newest packets by at most a third.
/// Measured on recorded cubes at 5 % loss: without this limit the stream takes 1.4 kbit/s more and errors fall by a
/// thirtieth; with a limit of a tenth a quarter more is lost.
const LONGER: usize = 3;

/// A repair symbol that was sent.
#[derive(Clone, Debug)]
struct SentRepairSymbol {
    /// One more than the number of the newest packet when it was sent.
    end: u64,
    numbers: Vec<u64>,
    datagram: Bytes,
}

/// A repair symbol that was requested; it may also serve other receivers.
#[derive(Clone, Debug)]
struct RequestedRepairSymbol {
    sent: SentRepairSymbol,
    /// The number of times it was sent.
    requests: u32,
    /// The lost packets of the receiver that was sent it last. If the same packets are requested again, this symbol
    /// does not help.
    last: Vec<u64>,
}

/// A receiver's request for lost packets.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SymbolRequest {
    /// The receiver's report covers the packets below this number.
    pub(crate) received_below: u64,
    /// The number of repair symbols that the receiver requests.
    pub(crate) wanted: usize,
    /// The receiver was also sent the unrequested repair symbols from this packet number on.
    pub(crate) sent_from: u64,
}

/// The most times that a requested repair symbol is sent, so that no receiver receives the same one forever.
const SYMBOL_REUSE_MAX: u32 = 4;

/// The source symbols of recent packets, and the repair symbols sent for them.
#[derive(Clone, Debug, Default)]
pub(crate) struct FecEncoder {
    next: u64,
    /// The source symbols of the packets below `next`, oldest first; empty for packets that cannot be recovered.
    source_symbols: VecDeque<Vec<u8>>,
    /// The first packet that no repair symbol covers yet, and the first that at most one covers. Every packet is
    /// covered twice.
    uncovered: u64,
    covered_once: u64,
    /// True if the packets of the present tick are two halves of one.
    halved: bool,
    redundancy: Redundancy,
    /// The number of ticks that the first uncovered packet has waited.
    ticks_waited: u32,
    row: u8,
    /// Repair symbols over packets whose source symbols are kept.
    sent: VecDeque<SentRepairSymbol>,
    /// The newest repair symbols requested since the last tick.
    requested: VecDeque<RequestedRepairSymbol>,
}

impl FecEncoder {
    /// Adds a sent packet.
    pub(crate) fn record(&mut self, number: u64, datagram: &[u8]) {
        if self.source_symbols.len() == FEC_SPAN as usize {
            self.source_symbols.pop_front();
        }
        let source_symbol = source_symbol_of(datagram).map(|(_, source_symbol)| source_symbol);
        self.source_symbols
            .push_back(source_symbol.unwrap_or_default());
        self.next = number + 1;
    }

    /// Ends a published tick: encodes the repair symbols that are due and appends them to `out`.
    pub(crate) fn end_tick(
        &mut self,
        stream: StreamId,
        redundancy: Redundancy,
        out: &mut Vec<Bytes>,
    ) {
        self.requested.clear();
        self.redundancy = redundancy;
        let halved = core::mem::take(&mut self.halved);
        let oldest = self.oldest();
        self.sent.retain(|sent| sent.end > oldest);
        let Some(ticks) = redundancy.ticks() else {
            (self.uncovered, self.covered_once) = (self.next, self.next);
            self.ticks_waited = 0;
            return;
        };
        self.uncovered = self.uncovered.max(oldest);
        self.covered_once = self.covered_once.max(oldest);
        if self.uncovered == self.next {
            return;
        }
        self.ticks_waited += 1;
        if self.ticks_waited < ticks && !halved {
            return;
        }
        self.ticks_waited = 0;
        while self.uncovered < self.next {
            let end = self.next.min(self.uncovered + COVERED);
            let from = (end.saturating_sub(COVERED)).max(oldest);
            let longest_of = |numbers: core::ops::Range<u64>, most: usize| {
                let lengths = numbers.map(|number| self.source_symbol(number).len());
                lengths
                    .filter(|bytes| *bytes <= most)
                    .max()
                    .unwrap_or_default()
            };
            let fresh = longest_of(self.uncovered..end, usize::MAX);
            let covered_once = self.covered_once.max(from)..end;
            let longest = longest_of(covered_once, fresh + fresh / LONGER);
            let numbers = (from..end)
                .filter(|number| (1..=longest).contains(&self.source_symbol(*number).len()));
            let numbers: Vec<u64> = numbers.collect();
            for _ in 0..redundancy.repair_symbols(end - self.uncovered) {
                if let Some(sent) = self.encode_symbol(stream, &numbers) {
                    out.push(sent.datagram.clone());
                    self.sent.push_back(sent);
                }
            }
            (self.covered_once, self.uncovered) = (self.uncovered, end);
        }
    }

    /// True if a tick of this many bytes is sent in two packets.
    pub(crate) const fn halves(&self, bytes: usize) -> bool {
        self.redundancy.halves(bytes)
    }

    /// Notes that the packets of the present tick are two halves of one.
    pub(crate) const fn halve(&mut self) {
        self.halved = true;
    }

    /// Answers a receiver that lost packets and requests repair symbols, taking symbols in flight into account. Appends
    /// to `out`, and returns the lost packets that must be refreshed.
    pub(crate) fn answer(
        &mut self,
        stream: StreamId,
        lost: impl Iterator<Item = u64>,
        request: SymbolRequest,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        let SymbolRequest {
            received_below,
            wanted,
            ..
        } = request;
        let (recent, old): (Vec<u64>, Vec<u64>) =
            lost.partition(|number| wanted > 0 && !self.source_symbol(*number).is_empty());
        if recent.is_empty() {
            return old;
        }
        let of_use =
            |sent: &SentRepairSymbol| sent.numbers.iter().any(|number| recent.contains(number));
        let unreported = received_below.max(request.sent_from);
        let under_way = self
            .sent
            .iter()
            .filter(|sent| sent.end > unreported && of_use(sent));
        let wanted = wanted.min(recent.len());
        let mut wanted = self.redundancy.answers(wanted, under_way.count());
        // One symbol serves all receivers that lost packets covered by it, except one that requests the same packets
        // again.
        for requested in &mut self.requested {
            let sent = &requested.sent;
            let serves = recent.iter().all(|number| sent.numbers.contains(number))
                && sent.end <= received_below;
            if wanted > 0
                && serves
                && requested.requests < SYMBOL_REUSE_MAX
                && requested.last != recent
            {
                out.push(sent.datagram.clone());
                wanted -= 1;
                requested.requests += 1;
                requested.last.clone_from(&recent);
            }
        }
        let numbers = self.covered(&recent, received_below);
        for _ in 0..wanted {
            if let Some(sent) = self.encode_symbol(stream, &numbers) {
                out.push(sent.datagram.clone());
                if self.requested.len() == REPAIR_SYMBOLS_KEPT {
                    self.requested.pop_front();
                }
                self.requested.push_back(RequestedRepairSymbol {
                    sent: SentRepairSymbol {
                        end: received_below,
                        ..sent
                    },
                    requests: 1,
                    last: recent.clone(),
                });
            }
        }
        old
    }

    /// The packets that a repair symbol for these lost ones covers: none longer than the longest of them.
    fn covered(&self, lost: &[u64], received_below: u64) -> Vec<u64> {
        let bytes = |number: &u64| self.source_symbol(*number).len();
        let longest = lost.iter().map(bytes).max();
        let from = lost.iter().copied().min().unwrap_or(received_below);
        let numbers = from..self.next.min(received_below);
        numbers
            .filter(|number| bytes(number) > 0 && Some(bytes(number)) <= longest)
            .collect()
    }

    /// Encodes a repair symbol over these packets, in the least recently used row; `None` if there are no packets.
    fn encode_symbol(&mut self, stream: StreamId, numbers: &[u64]) -> Option<SentRepairSymbol> {
        let last = *numbers.last()?;
        let mut repair_symbol = RepairSymbol::begin(self.row, last);
        for number in numbers {
            repair_symbol.add(*number, last - number, self.source_symbol(*number));
        }
        self.row = (self.row + 1) % FEC_ROWS;
        Some(SentRepairSymbol {
            end: self.next,
            numbers: numbers.to_vec(),
            datagram: Bytes::from(repair_symbol.encode(stream)),
        })
    }

    fn oldest(&self) -> u64 {
        self.next - self.source_symbols.len() as u64
    }

    fn source_symbol(&self, number: u64) -> &[u8] {
        let place = number.checked_sub(self.oldest());
        let source_symbol = place.and_then(|place| self.source_symbols.get(place as usize));
        source_symbol.map_or(&[], Vec::as_slice)
    }
}

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
mod tests;
