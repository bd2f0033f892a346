//! The source symbols of a stream's recent packets, in reused buffers.
//!
//! At most one symbol for each of the last [`FEC_SPAN`] numbers. A new symbol replaces the one that is [`FEC_SPAN`]
//! numbers older.

use alloc::vec::Vec;

use crate::limits::FEC_SPAN;
use crate::packet::LargestPacket;

/// Source symbols by number.
#[derive(Clone, Debug, Default)]
pub(crate) struct SourceSymbols {
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
    pub(crate) fn new(largest_packet: LargestPacket) -> Self {
        Self {
            largest_packet,
            places: Vec::new(),
        }
    }

    /// Keeps the source symbol of a packet.
    pub(crate) fn keep(&mut self, number: u64, source_symbol: &[u8]) {
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
    pub(crate) fn forget(&mut self, number: u64) {
        if self.get(number).is_some() {
            self.places[place_of(number)].number = None;
        }
    }

    /// Drops the source symbols of all packets below this number.
    pub(crate) fn forget_below(&mut self, oldest: u64) {
        for place in &mut self.places {
            place.number = place.number.filter(|number| *number >= oldest);
        }
    }

    /// The source symbol of a packet, if it is kept.
    pub(crate) fn get(&self, number: u64) -> Option<&[u8]> {
        let place = self.places.get(place_of(number))?;
        (place.number == Some(number)).then_some(&place.source_symbol)
    }
}

const fn place_of(number: u64) -> usize {
    (number % FEC_SPAN as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

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
