//! A repair symbol: a sum over recent packets that recovers a lost one.
//!
//! Codec and arithmetic only; `stream` decides which packets a symbol covers and how losses are recovered. Invariant:
//! the packets do not depend on repair symbols, so a packet can be read alone.
//!
//! Bytes are elements of GF(256). Addition is exclusive or; multiplication is that of polynomials over one bit modulo
//! x⁸ + x⁴ + x³ + x² + 1 (PROTOCOL 5.16). Invariant: every non-zero element has an inverse.

use alloc::vec::Vec;

use super::header::{Datagram, Head, Low16, PacketKind, StreamId};
use crate::limits::{DATAGRAM_BYTES_MAX, FEC_ROWS, FEC_SPAN};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Bytes before the sums: kind, stream, last, covered, row.
pub(super) const REPAIR_SYMBOL_HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 5 + 1;
/// Bytes of a source symbol before the updates: kind, tick, scene events.
pub(super) const SOURCE_SYMBOL_HEAD_BYTES: usize = 1 + 2 + 2;
/// The longest source symbol, bytes.
const SOURCE_SYMBOL_BYTES_MAX: usize = DATAGRAM_BYTES_MAX - REPAIR_SYMBOL_HEAD_BYTES_MAX;

/// A linear combination of source symbols in GF(256).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RepairSymbol {
    /// The number of the newest covered packet.
    pub last: Low16,
    /// The other covered packets as bits: bit 0 is the packet before the newest, and so on.
    pub covered: u32,
    /// The row of the coefficient matrix; below [`FEC_ROWS`].
    pub row: u8,
    /// The sums, without trailing zeros.
    pub sums: Vec<u8>,
}

impl RepairSymbol {
    /// The coefficient of a packet in a row. The coefficients of some rows and as many packets form a Cauchy matrix. It
    /// has an inverse as long as no two packet numbers differ by 128 (PROTOCOL 5.16).
    #[must_use]
    pub const fn factor(row: u8, number: u64) -> u8 {
        inverse((FEC_ROWS | row) ^ (number % FEC_ROWS as u64) as u8)
    }

    /// The numbers of the covered packets, newest first. `last` is the full number of the newest one.
    pub fn numbers(&self, last: u64) -> impl Iterator<Item = u64> + use<> {
        let mask = u64::from(self.covered) << 1 | 1;
        (0..u64::from(FEC_SPAN)).filter_map(move |back| {
            let covered = mask >> back & 1 == 1;
            last.checked_sub(back).filter(|_| covered)
        })
    }

    /// The repair symbol of some state packets, the newest last, whose numbers lie within [`FEC_SPAN`]. `None` for no
    /// packets, or if one of them cannot be covered.
    #[must_use]
    pub fn of(row: u8, packets: &[(u64, &[u8])]) -> Option<Self> {
        let (last, _) = *packets.last()?;
        let mut repair_symbol = Self::begin(row, last);
        for (number, datagram) in packets {
            let (_, source_symbol) = source_symbol_of(datagram)?;
            repair_symbol.add(*number, last.checked_sub(*number)?, &source_symbol);
        }
        repair_symbol
            .sums
            .truncate(without_zeros(&repair_symbol.sums).len());
        Some(repair_symbol)
    }

    /// A repair symbol that covers nothing yet.
    pub(crate) fn begin(row: u8, last: u64) -> Self {
        Self {
            last: Low16::of(last),
            covered: 0,
            row,
            sums: Vec::new(),
        }
    }

    /// Adds the source symbol of a packet that lies `back` numbers before the newest one.
    pub(crate) fn add(&mut self, number: u64, back: u64, source_symbol: &[u8]) {
        if back > 0 {
            self.covered |= 1 << (back - 1);
        }
        if self.sums.len() < source_symbol.len() {
            self.sums.resize(source_symbol.len(), 0);
        }
        add_times(
            &mut self.sums,
            Self::factor(self.row, number),
            source_symbol,
        );
    }

    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: PacketKind::RepairSymbol,
            stream,
        }
        .encode(&mut to);
        self.last.encode(&mut to);
        to.varint(u64::from(self.covered));
        to.u8(self.row);
        to.raw(without_zeros(&self.sums));
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no repair symbol.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let last = Low16::decode(&mut from)?;
        let covered = from.varint32()?;
        let row = from.u8()?;
        let sums = from.rest();
        let far = covered.checked_shr(FEC_SPAN - 1).unwrap_or(0) != 0;
        if row >= FEC_ROWS || far {
            return Err(Malformed::OutOfRange);
        }
        if sums.len() > SOURCE_SYMBOL_BYTES_MAX {
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

/// The source symbol of a state packet: its kind, and the bytes after its number. `None` for another datagram, for a
/// packet without updates, and for one that is too long.
pub(crate) fn source_symbol_of(datagram: &[u8]) -> Option<(Low16, Vec<u8>)> {
    let mut source_symbol = Vec::new();
    let number = source_symbol_into(&Datagram::open(datagram).ok()?, &mut source_symbol)?;
    Some((number, source_symbol))
}

/// As [`source_symbol_of`], into a buffer whose content is replaced.
pub(crate) fn source_symbol_into(
    datagram: &Datagram<'_>,
    source_symbol: &mut Vec<u8>,
) -> Option<Low16> {
    source_symbol.clear();
    let mut reader = datagram.body();
    let kind = match datagram.head().kind {
        PacketKind::Updates => 0,
        PacketKind::UpdatesEnd => 1,
        _ => return None,
    };
    let number = Low16::decode(&mut reader).ok()?;
    let rest = reader.rest();
    // Trailing zeros would be lost; a packet with updates never ends in a zero byte.
    let is_recoverable = rest.last().is_some_and(|last| *last != 0);
    if !is_recoverable || rest.len() >= SOURCE_SYMBOL_BYTES_MAX {
        return None;
    }
    source_symbol.push(kind);
    source_symbol.extend_from_slice(rest);
    Some(number)
}

/// The datagram of a recovered source symbol; `None` if no packet has this symbol. It is shorter than the repair
/// symbol, or no longer than another packet that the symbol covers.
pub(crate) fn packet_of(stream: StreamId, number: u64, source_symbol: &[u8]) -> Option<Vec<u8>> {
    let (kind, rest) = without_zeros(source_symbol).split_first()?;
    let kind = match kind {
        0 => PacketKind::Updates,
        1 => PacketKind::UpdatesEnd,
        _ => return None,
    };
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    Low16::of(number).encode(&mut to);
    to.raw(rest);
    Some(to.into_bytes())
}

fn without_zeros(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0);
    &bytes[..end.map_or(0, |end| end + 1)]
}

/// x⁸ + x⁴ + x³ + x² + 1, of which x is a generator. Source: PROTOCOL 5.16.
const POLYNOMIAL: u16 = 0x11d;

/// Powers of x, twice over so that a sum of two logarithms needs no reduction, and logarithms to base x.
struct GaloisTables {
    of: [u8; 510],
    log: [u8; 256],
}

const POWERS: GaloisTables = powers();

const fn powers() -> GaloisTables {
    let mut powers = GaloisTables {
        of: [0; 510],
        log: [0; 256],
    };
    let mut value = 1_u16;
    let mut exponent = 0;
    while exponent < 255 {
        powers.of[exponent] = value as u8;
        powers.of[exponent + 255] = value as u8;
        powers.log[value as usize] = exponent as u8;
        value <<= 1;
        if value > 0xff {
            value ^= POLYNOMIAL;
        }
        exponent += 1;
    }
    powers
}

/// The product of two elements.
pub(crate) const fn times(a: u8, b: u8) -> u8 {
    if a == 0 || b == 0 {
        return 0;
    }
    let exponent = POWERS.log[a as usize] as usize + POWERS.log[b as usize] as usize;
    POWERS.of[exponent]
}

/// The inverse of a non-zero element; zero for zero.
pub(crate) const fn inverse(a: u8) -> u8 {
    if a == 0 {
        return 0;
    }
    POWERS.of[255 - POWERS.log[a as usize] as usize]
}

/// Adds `factor` times each term to the sum at the same position. Terms beyond the sums are ignored.
pub(crate) fn add_times(sums: &mut [u8], factor: u8, terms: &[u8]) {
    if factor == 0 {
        return;
    }
    let log = usize::from(POWERS.log[usize::from(factor)]);
    for (sum, term) in sums.iter_mut().zip(terms) {
        if *term != 0 {
            *sum ^= POWERS.of[log + usize::from(POWERS.log[usize::from(*term)])];
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    fn decode(datagram: &[u8]) -> Result<RepairSymbol, Malformed> {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader)?.kind, PacketKind::RepairSymbol);
        RepairSymbol::decode(reader)
    }

    proptest! {
        #[test]
        fn a_repair_symbol_round_trips(last: u16, covered in 0_u32..1 << 31, row in 0..FEC_ROWS, sums in vec(any::<u8>(), 0..SOURCE_SYMBOL_BYTES_MAX)) {
            let sums = without_zeros(&sums).to_vec();
            let repair_symbol = RepairSymbol { last: Low16(last), covered, row, sums };
            let datagram = repair_symbol.encode(StreamId(300));
            prop_assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            prop_assert_eq!(decode(&datagram), Ok(repair_symbol));
        }

        #[test]
        fn arbitrary_bytes_are_refused_or_reencode_identically(bytes in vec(any::<u8>(), 0..40)) {
            let mut datagram = alloc::vec![0x19];
            datagram.extend(&bytes);
            if let Ok(repair_symbol) = decode(&datagram) {
                prop_assert_eq!(repair_symbol.encode(StreamId(1)), datagram);
            }
        }

        #[test]
        fn a_packet_is_recovered_from_its_source_symbol(kind in 0_u8..2, number: u16, rest in vec(any::<u8>(), 1..200), zeros in 0_usize..9) {
            let mut datagram = alloc::vec![kind | 0x70];
            datagram.extend(number.to_le_bytes());
            datagram.extend(&rest);
            match source_symbol_of(&datagram) {
                Some((low, mut source_symbol)) => {
                    prop_assert_eq!(low, Low16(number));
                    source_symbol.resize(source_symbol.len() + zeros, 0);
                    let number = 3 << 16 | u64::from(number);
                    prop_assert_eq!(packet_of(StreamId(7), number, &source_symbol), Some(datagram));
                }
                None => prop_assert_eq!(rest.last(), Some(&0)),
            }
        }
    }

    #[test]
    fn the_coefficients_of_a_row_are_distinct_and_not_zero() {
        for row in 0..FEC_ROWS {
            let mut factors: Vec<u8> = (0..128).map(|n| RepairSymbol::factor(row, n)).collect();
            factors.sort_unstable();
            factors.dedup();
            assert_eq!(factors.len(), 128);
            assert_ne!(factors[0], 0);
        }
    }

    #[test]
    fn invalid_repair_symbols_are_refused() {
        let repair_symbol = RepairSymbol {
            last: Low16(5),
            covered: 3,
            row: 2,
            sums: alloc::vec![1, 2, 3],
        };
        let good = repair_symbol.encode(StreamId(1));
        assert_eq!(good, [0x19, 5, 0, 3, 2, 1, 2, 3]);
        let with = |place: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[place] = byte;
            decode(&bytes)
        };
        assert_eq!(with(4, FEC_ROWS), Err(Malformed::OutOfRange));
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

    /// Multiplication by shifts and reduction, as the specification defines it.
    fn by_shifts(a: u8, b: u8) -> u8 {
        let mut sum = 0_u16;
        for bit in 0..8 {
            if b >> bit & 1 == 1 {
                sum ^= u16::from(a) << bit;
            }
        }
        for bit in (8..16).rev() {
            if sum >> bit & 1 == 1 {
                sum ^= POLYNOMIAL << (bit - 8);
            }
        }
        sum as u8
    }

    #[test]
    fn products_are_those_of_polynomials_and_every_element_has_an_inverse() {
        for a in 0..=255 {
            for b in 0..=255 {
                assert_eq!(times(a, b), by_shifts(a, b), "{a} {b}");
            }
            let one = u8::from(a != 0);
            assert_eq!(times(a, inverse(a)), one, "{a}");
        }
    }

    #[test]
    fn terms_beyond_the_sums_are_ignored() {
        let mut sums = [1, 2, 3];
        add_times(&mut sums, 7, &[0, 9]);
        assert_eq!(sums, [1, 2 ^ times(7, 9), 3]);
        add_times(&mut sums, 0, &[5; 3]);
        add_times(&mut sums, 1, &[1, 2 ^ times(7, 9), 3, 4, 5]);
        assert_eq!(sums, [0; 3]);
    }
}
