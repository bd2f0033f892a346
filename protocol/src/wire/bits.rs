//! Bits, low bit of the first byte first, and the codes built from them.
//!
//! The only place with bit shifts. Writing asserts; reading never does. The last byte is filled with zeros, and a
//! reader refuses any other filling (PROTOCOL 5.1).

use alloc::vec::Vec;

use super::Malformed;

/// A sink of bits.
pub trait PutBits {
    /// The low `count` bits of `value`; `count` is at most 32.
    fn bits(&mut self, value: u32, count: u32);

    /// One bit.
    fn flag(&mut self, flag: bool) {
        self.bits(u32::from(flag), 1);
    }

    /// An unsigned number by an exponential Golomb code of order `order` (PROTOCOL 5.2).
    ///
    /// # Panics
    ///
    /// When `value` is above `GOLOMB_MAX`.
    fn golomb(&mut self, value: u32, order: u32) {
        assert!(
            value <= GOLOMB_MAX,
            "{value} is too large for a Golomb code"
        );
        let shifted = value + (1 << order);
        let extra = shifted.ilog2() - order;
        for _ in 0..extra {
            self.flag(true);
        }
        self.flag(false);
        let width = extra + order;
        self.bits(shifted & !(1 << width), width);
    }

    /// A signed number: 0, -1, 1, -2, ... are the unsigned 0, 1, 2, 3, ...
    ///
    /// # Panics
    ///
    /// As [`Self::golomb`].
    fn signed_golomb(&mut self, value: i32, order: u32) {
        self.golomb(((value << 1) ^ (value >> 31)) as u32, order);
    }
}

/// A source of bits.
pub trait TakeBits {
    /// The next `count` bits as a number; `count` is at most 32.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when fewer bits are left; so for every method below.
    fn bits(&mut self, count: u32) -> Result<u32, Malformed>;

    /// One bit.
    ///
    /// # Errors
    ///
    /// As [`Self::bits`].
    fn flag(&mut self) -> Result<bool, Malformed> {
        self.bits(1).map(|bit| bit == 1)
    }

    /// An unsigned number by an exponential Golomb code of order `order`.
    ///
    /// # Errors
    ///
    /// [`Malformed::OutOfRange`] above `GOLOMB_MAX`.
    fn golomb(&mut self, order: u32) -> Result<u32, Malformed> {
        let mut extra = 0;
        while self.flag()? {
            extra += 1;
            if extra + order > 31 {
                return Err(Malformed::OutOfRange);
            }
        }
        let width = extra + order;
        let shifted = self.bits(width)? | (1 << width);
        let value = shifted - (1 << order);
        if value > GOLOMB_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(value)
    }

    /// A signed number; see [`PutBits::signed_golomb`].
    ///
    /// # Errors
    ///
    /// As [`Self::golomb`].
    fn signed_golomb(&mut self, order: u32) -> Result<i32, Malformed> {
        let unsigned = self.golomb(order)?;
        Ok((unsigned >> 1) as i32 ^ -((unsigned & 1) as i32))
    }
}

/// Appends bits to a buffer.
#[derive(Debug, Default)]
pub struct BitWriter {
    bytes: Vec<u8>,
    pending: u64,
    pending_bits: u32,
}

impl BitWriter {
    /// Continues after bytes that are written already.
    #[must_use]
    pub fn after(bytes: Vec<u8>) -> Self {
        Self {
            bytes,
            pending: 0,
            pending_bits: 0,
        }
    }

    /// Bits written so far, with those before this writer.
    #[must_use]
    pub(crate) fn bit_len(&self) -> usize {
        self.bytes.len() * 8 + self.pending_bits as usize
    }

    /// Fills the last byte with zeros and returns all bytes.
    #[must_use]
    pub fn into_bytes(mut self) -> Vec<u8> {
        if self.pending_bits > 0 {
            self.bytes.push(self.pending as u8);
        }
        self.bytes
    }
}

impl PutBits for BitWriter {
    /// Low bit first.
    ///
    /// # Panics
    ///
    /// When `value` does not fit `count` bits.
    fn bits(&mut self, value: u32, count: u32) {
        assert!(
            count == 32 || (count < 32 && value >> count == 0),
            "{value} does not fit {count} bits"
        );
        self.pending |= u64::from(value) << self.pending_bits;
        self.pending_bits += count;
        while self.pending_bits >= 8 {
            self.bytes.push(self.pending as u8);
            self.pending >>= 8;
            self.pending_bits -= 8;
        }
    }
}

/// Largest number of a Golomb code: any residual on the widest grid, mapped to unsigned.
const GOLOMB_MAX: u32 = (1 << 31) + (1 << 30);

/// Length of the code of [`BitWriter::golomb`] in bits.
#[must_use]
pub(crate) const fn golomb_len(value: u32, order: u32) -> u32 {
    let extra = (value + (1 << order)).ilog2() - order;
    2 * extra + 1 + order
}

/// Takes bits off the front of a slice.
#[derive(Clone, Debug)]
pub struct BitReader<'a> {
    bytes: &'a [u8],
    position: usize,
}

impl<'a> BitReader<'a> {
    /// Reads from the low bit of the first byte.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, position: 0 }
    }

    /// Number of bits read.
    #[must_use]
    pub const fn position(&self) -> usize {
        self.position
    }

    /// Ends reading.
    ///
    /// # Errors
    ///
    /// [`Malformed::Trailing`] when a whole byte is left, [`Malformed::NotCanonical`] when the filling is not zero.
    pub fn finish(mut self) -> Result<(), Malformed> {
        let left = self.bytes.len() * 8 - self.position;
        if left >= 8 {
            return Err(Malformed::Trailing);
        }
        if self.bits(left as u32)? != 0 {
            return Err(Malformed::NotCanonical);
        }
        Ok(())
    }
}

impl TakeBits for BitReader<'_> {
    /// The next `count` bits as a number; `count` is at most 32.
    ///
    /// # Errors
    ///
    /// [`Malformed::Truncated`] when fewer are left.
    fn bits(&mut self, count: u32) -> Result<u32, Malformed> {
        let end = self.position + count as usize;
        if end > self.bytes.len() * 8 {
            return Err(Malformed::Truncated);
        }
        let first = self.position / 8;
        // Any 32 consecutive bits lie within five bytes.
        let mut window = 0_u64;
        for (place, byte) in self.bytes[first..].iter().take(5).enumerate() {
            window |= u64::from(*byte) << (8 * place);
        }
        self.position = end;
        let mask = (1_u64 << count) - 1;
        Ok(((window >> ((end - count as usize) % 8)) & mask) as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug)]
    enum BitSpan {
        Bits(u32, u32),
        Golomb(u32, u32),
        Signed(i32, u32),
    }

    fn piece() -> impl Strategy<Value = BitSpan> {
        prop_oneof![
            (any::<u32>(), 0_u32..=32).prop_map(|(value, count)| {
                let mask = (1_u64 << count) - 1;
                BitSpan::Bits((u64::from(value) & mask) as u32, count)
            }),
            (0..=GOLOMB_MAX, 0_u32..12).prop_map(|(value, order)| BitSpan::Golomb(value, order)),
            (0_u32..500, 0_u32..12).prop_map(|(value, order)| BitSpan::Golomb(value, order)),
            (-(1_i32 << 30)..1 << 30, 0_u32..12)
                .prop_map(|(value, order)| BitSpan::Signed(value, order)),
        ]
    }

    proptest! {
        #[test]
        fn bit_spans_round_trip_in_order(pieces in proptest::collection::vec(piece(), 0..40)) {
            let mut writer = BitWriter::default();
            let mut expected = 0;
            for piece in &pieces {
                match *piece {
                    BitSpan::Bits(value, count) => writer.bits(value, count),
                    BitSpan::Golomb(value, order) => {
                        expected = writer.bit_len() + golomb_len(value, order) as usize;
                        writer.golomb(value, order);
                        prop_assert_eq!(writer.bit_len(), expected);
                    }
                    BitSpan::Signed(value, order) => writer.signed_golomb(value, order),
                }
            }
            prop_assert!(expected <= writer.bit_len());
            let bytes = writer.into_bytes();
            let mut reader = BitReader::new(&bytes);
            for piece in &pieces {
                match *piece {
                    BitSpan::Bits(value, count) => prop_assert_eq!(reader.bits(count), Ok(value)),
                    BitSpan::Golomb(value, order) => prop_assert_eq!(reader.golomb(order), Ok(value)),
                    BitSpan::Signed(value, order) => prop_assert_eq!(reader.signed_golomb(order), Ok(value)),
                }
            }
            prop_assert_eq!(reader.finish(), Ok(()));
        }

        #[test]
        fn no_bytes_make_a_bit_reader_panic(
            bytes in proptest::collection::vec(any::<u8>(), 0..40), order in 0_u32..12,
        ) {
            let mut reader = BitReader::new(&bytes);
            while reader.golomb(order).is_ok() {}
            let mut reader = BitReader::new(&bytes);
            while reader.signed_golomb(order).is_ok() {}
        }
    }

    #[test]
    fn filling_other_than_zero_is_refused() {
        let mut reader = BitReader::new(&[0b1000_0001]);
        assert_eq!(reader.bits(3), Ok(1));
        assert_eq!(reader.finish(), Err(Malformed::NotCanonical));
        assert_eq!(BitReader::new(&[0]).finish(), Err(Malformed::Trailing));
    }
}
