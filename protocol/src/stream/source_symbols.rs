//! The source_symbols of a stream's last packets, in buffers that are used again.
//!
//! Of each of the last [`FEC_SPAN`] numbers one source_symbol at most; what is kept anew takes the place of what is as many
//! numbers older.

use alloc::vec::Vec;

use crate::limits::{DATAGRAM_BYTES_MAX, FEC_SPAN};

/// SourceSymbols by number.
#[derive(Clone, Debug, Default)]
pub(crate) struct SourceSymbols {
    /// Empty until the first is kept; then as many places as numbers may be kept of.
    places: Vec<SymbolSlot>,
}

#[derive(Clone, Debug, Default)]
struct SymbolSlot {
    /// Of which packet, if of any.
    number: Option<u64>,
    source_symbol: Vec<u8>,
}

impl SourceSymbols {
    /// Keeps the source_symbol of a packet.
    pub(crate) fn keep(&mut self, number: u64, source_symbol: &[u8]) {
        if self.places.is_empty() {
            self.places.resize(FEC_SPAN as usize, SymbolSlot::default());
        }
        let place = &mut self.places[place_of(number)];
        place.number = Some(number);
        place.source_symbol.clear();
        // Room for any packet at once: a longer one than the place had before would ask for more.
        place.source_symbol.reserve_exact(DATAGRAM_BYTES_MAX);
        place.source_symbol.extend_from_slice(source_symbol);
    }

    /// Keeps a packet's source_symbol no longer.
    pub(crate) fn forget(&mut self, number: u64) {
        if self.get(number).is_some() {
            self.places[place_of(number)].number = None;
        }
    }

    /// Keeps no source_symbol of a packet below this number.
    pub(crate) fn forget_below(&mut self, oldest: u64) {
        for place in &mut self.places {
            place.number = place.number.filter(|number| *number >= oldest);
        }
    }

    /// The source_symbol of a packet, if it is kept.
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
    fn a_column_is_kept_until_it_is_forgotten_or_its_place_is_taken() {
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
