//! A sum over a stream's last packets, from which a lost one can be had.
//!
//! Codec, and the columns that are summed; which packets are covered, and what a listener makes of it, is decided in
//! `stream`. Invariant: the packets themselves know nothing of it, so that they are said once and read alone.

use alloc::vec::Vec;

use super::galois::{add_times, inverse};
use super::header::{Head, Kind, Low16, StreamId};
use crate::limits::{DATAGRAM_BYTES_MAX, PARITY_ROWS, PARITY_SPAN};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Bytes before the sums: kind, stream, last, covered and row.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 5 + 1;
/// Bytes of a column before the updates: kind, tick and notices.
pub(super) const COLUMN_HEAD_BYTES: usize = 1 + 2 + 2;
/// The longest column.
pub(crate) const COLUMN_BYTES_MAX: usize = DATAGRAM_BYTES_MAX - HEAD_BYTES_MAX;

/// A linear sum over the columns of some packets.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parity {
    /// The number of the newest packet that it covers.
    pub last: Low16,
    /// Which packets it covers beside that one: bit 0 is for the one before it, and so on.
    pub covered: u32,
    /// Which factors the packets have in it; below [`PARITY_ROWS`].
    pub row: u8,
    /// The sums, without zeros at the end.
    pub sums: Vec<u8>,
}

impl Parity {
    /// The factor of a packet in a row. All factors of some rows and as many packets are a Cauchy matrix, which has an
    /// inverse, while no two of the packets' numbers are 128 apart (PROTOCOL 5.16).
    #[must_use]
    pub const fn factor(row: u8, number: u64) -> u8 {
        inverse((PARITY_ROWS | row) ^ (number % PARITY_ROWS as u64) as u8)
    }

    /// The numbers of the packets that it covers, newest first, if `last` is the number of the newest.
    pub fn numbers(&self, last: u64) -> impl Iterator<Item = u64> + use<> {
        let mask = u64::from(self.covered) << 1 | 1;
        (0..u64::from(PARITY_SPAN)).filter_map(move |back| {
            let covered = mask >> back & 1 == 1;
            last.checked_sub(back).filter(|_| covered)
        })
    }

    /// The parity of some state packets, the newest last, whose numbers all lie within [`PARITY_SPAN`]; `None` if there
    /// is none, or one that is never covered.
    #[must_use]
    pub fn of(row: u8, packets: &[(u64, &[u8])]) -> Option<Self> {
        let (last, _) = *packets.last()?;
        let mut parity = Self::begin(row, last);
        for (number, datagram) in packets {
            let (_, column) = column_of(datagram)?;
            parity.add(*number, last.checked_sub(*number)?, &column);
        }
        parity.sums.truncate(without_zeros(&parity.sums).len());
        Some(parity)
    }

    /// A sum over nothing yet.
    pub(crate) fn begin(row: u8, last: u64) -> Self {
        Self {
            last: Low16::of(last),
            covered: 0,
            row,
            sums: Vec::new(),
        }
    }

    /// Adds the column of a packet; `back`: how many numbers before the newest.
    pub(crate) fn add(&mut self, number: u64, back: u64, column: &[u8]) {
        if back > 0 {
            self.covered |= 1 << (back - 1);
        }
        if self.sums.len() < column.len() {
            self.sums.resize(column.len(), 0);
        }
        add_times(&mut self.sums, Self::factor(self.row, number), column);
    }

    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: Kind::Parity,
            stream,
        }
        .encode(&mut to);
        self.last.encode(&mut to);
        to.varint(u64::from(self.covered));
        to.u8(self.row);
        to.raw(without_zeros(&self.sums));
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a parity.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let last = Low16::decode(&mut from)?;
        let covered = from.varint32()?;
        let row = from.u8()?;
        let sums = from.rest();
        let far = covered.checked_shr(PARITY_SPAN - 1).unwrap_or(0) != 0;
        if row >= PARITY_ROWS || far {
            return Err(Malformed::OutOfRange);
        }
        if sums.len() > COLUMN_BYTES_MAX {
            return Err(Malformed::TooLong);
        }
        if sums.last() == Some(&0) {
            return Err(Malformed::NotCanonical);
        }
        Ok(Self {
            last,
            covered,
            row,
            sums: sums.to_vec(),
        })
    }
}

/// The bytes of a state packet that are summed: its kind, and what follows its number. `None` of another datagram, of a
/// packet that says nothing, and of one that is too long.
pub(crate) fn column_of(datagram: &[u8]) -> Option<(Low16, Vec<u8>)> {
    let mut column = Vec::new();
    let number = column_into(datagram, &mut column)?;
    Some((number, column))
}

/// The same, in place of what was in `column`.
pub(crate) fn column_into(datagram: &[u8], column: &mut Vec<u8>) -> Option<Low16> {
    column.clear();
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader).ok()?;
    let kind = match head.kind {
        Kind::State => 0,
        Kind::StateEnd => 1,
        _ => return None,
    };
    let number = Low16::decode(&mut reader).ok()?;
    let rest = reader.rest();
    // Zeros at the end would not come back; a packet that says something ends in another byte.
    let comes_back = rest.last().is_some_and(|last| *last != 0);
    if !comes_back || rest.len() >= COLUMN_BYTES_MAX {
        return None;
    }
    column.push(kind);
    column.extend_from_slice(rest);
    Some(number)
}

/// The datagram of a column; `None` if no packet has this one.
pub(crate) fn packet_of(stream: StreamId, number: u64, column: &[u8]) -> Option<Vec<u8>> {
    let (kind, rest) = without_zeros(column).split_first()?;
    let kind = match kind {
        0 => Kind::State,
        1 => Kind::StateEnd,
        _ => return None,
    };
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    Low16::of(number).encode(&mut to);
    to.raw(rest);
    Some(to.into_bytes()).filter(|datagram| datagram.len() <= DATAGRAM_BYTES_MAX)
}

fn without_zeros(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0);
    &bytes[..end.map_or(0, |end| end + 1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    fn decode(datagram: &[u8]) -> Result<Parity, Malformed> {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader)?.kind, Kind::Parity);
        Parity::decode(reader)
    }

    proptest! {
        #[test]
        fn a_parity_comes_back(last: u16, covered in 0_u32..1 << 31, row in 0..PARITY_ROWS, sums in vec(any::<u8>(), 0..COLUMN_BYTES_MAX)) {
            let sums = without_zeros(&sums).to_vec();
            let parity = Parity { last: Low16(last), covered, row, sums };
            let datagram = parity.encode(StreamId(300));
            prop_assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            prop_assert_eq!(decode(&datagram), Ok(parity));
        }

        #[test]
        fn arbitrary_bytes_are_refused_or_come_back(bytes in vec(any::<u8>(), 0..40)) {
            let mut datagram = alloc::vec![0x19];
            datagram.extend(&bytes);
            if let Ok(parity) = decode(&datagram) {
                prop_assert_eq!(parity.encode(StreamId(1)), datagram);
            }
        }

        #[test]
        fn a_packet_comes_back_from_its_column(kind in 0_u8..2, number: u16, rest in vec(any::<u8>(), 1..200), zeros in 0_usize..9) {
            let mut datagram = alloc::vec![kind | 0x70];
            datagram.extend(number.to_le_bytes());
            datagram.extend(&rest);
            match column_of(&datagram) {
                Some((low, mut column)) => {
                    prop_assert_eq!(low, Low16(number));
                    column.resize(column.len() + zeros, 0);
                    let number = 3 << 16 | u64::from(number);
                    prop_assert_eq!(packet_of(StreamId(7), number, &column), Some(datagram));
                }
                None => prop_assert_eq!(rest.last(), Some(&0)),
            }
        }
    }

    #[test]
    fn the_factors_of_a_row_are_never_zero_and_all_different() {
        for row in 0..PARITY_ROWS {
            let mut factors: Vec<u8> = (0..128).map(|n| Parity::factor(row, n)).collect();
            factors.sort_unstable();
            factors.dedup();
            assert_eq!(factors.len(), 128);
            assert_ne!(factors[0], 0);
        }
    }

    #[test]
    fn what_no_publisher_says_is_refused() {
        let parity = Parity {
            last: Low16(5),
            covered: 3,
            row: 2,
            sums: alloc::vec![1, 2, 3],
        };
        let good = parity.encode(StreamId(1));
        assert_eq!(good, [0x19, 5, 0, 3, 2, 1, 2, 3]);
        let with = |place: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[place] = byte;
            decode(&bytes)
        };
        assert_eq!(with(4, PARITY_ROWS), Err(Malformed::OutOfRange));
        assert_eq!(with(7, 0), Err(Malformed::NotCanonical));
        let far = [0x19, 5, 0, 0x80, 0x80, 0x80, 0x80, 8, 2, 1];
        assert_eq!(decode(&far), Err(Malformed::OutOfRange));
        for cut in 1..5 {
            assert_eq!(decode(&good[..cut]), Err(Malformed::Truncated));
        }
        let mut long = good;
        long.resize(DATAGRAM_BYTES_MAX + 1, 1);
        assert_eq!(decode(&long), Err(Malformed::TooLong));
    }
}
