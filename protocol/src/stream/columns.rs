//! The columns of a stream's last packets, in buffers that are used again.
//!
//! Of each of the last [`PARITY_SPAN`] numbers one column at most; what is kept anew takes the place of what is as many
//! numbers older.

use alloc::vec::Vec;

use crate::limits::{DATAGRAM_BYTES_MAX, PARITY_SPAN};

/// Columns by number.
#[derive(Clone, Debug, Default)]
pub(crate) struct Columns {
    /// Empty until the first is kept; then as many places as numbers may be kept of.
    places: Vec<Place>,
}

#[derive(Clone, Debug, Default)]
struct Place {
    /// Of which packet, if of any.
    number: Option<u64>,
    column: Vec<u8>,
}

impl Columns {
    /// Keeps the column of a packet.
    pub(crate) fn keep(&mut self, number: u64, column: &[u8]) {
        if self.places.is_empty() {
            self.places.resize(PARITY_SPAN as usize, Place::default());
        }
        let place = &mut self.places[place_of(number)];
        place.number = Some(number);
        place.column.clear();
        // Room for any packet at once: a longer one than the place had before would ask for more.
        place.column.reserve_exact(DATAGRAM_BYTES_MAX);
        place.column.extend_from_slice(column);
    }

    /// Keeps a packet's column no longer.
    pub(crate) fn forget(&mut self, number: u64) {
        if self.get(number).is_some() {
            self.places[place_of(number)].number = None;
        }
    }

    /// Keeps no column of a packet below this number.
    pub(crate) fn forget_below(&mut self, oldest: u64) {
        for place in &mut self.places {
            place.number = place.number.filter(|number| *number >= oldest);
        }
    }

    /// The column of a packet, if it is kept.
    pub(crate) fn get(&self, number: u64) -> Option<&[u8]> {
        let place = self.places.get(place_of(number))?;
        (place.number == Some(number)).then_some(&place.column)
    }
}

const fn place_of(number: u64) -> usize {
    (number % PARITY_SPAN as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_is_kept_until_it_is_forgotten_or_its_place_is_taken() {
        let span = u64::from(PARITY_SPAN);
        let mut columns = Columns::default();
        assert_eq!(columns.get(7), None);
        columns.keep(7, &[1, 2, 3]);
        columns.keep(8, &[4]);
        assert_eq!(columns.get(7), Some(&[1, 2, 3][..]));
        assert_eq!(columns.get(7 + span), None);
        columns.keep(7 + span, &[5]);
        assert_eq!(
            (columns.get(7), columns.get(7 + span)),
            (None, Some(&[5][..]))
        );
        columns.forget(7);
        assert_eq!(columns.get(7 + span), Some(&[5][..]));
        columns.forget_below(9);
        assert_eq!(
            (columns.get(8), columns.get(7 + span)),
            (None, Some(&[5][..]))
        );
        columns.forget(7 + span);
        assert_eq!(columns.get(7 + span), None);
    }
}
