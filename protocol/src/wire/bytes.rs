//! Whole bytes: little-endian numbers, variable-length integers, `Wire`.
//!
//! Writing asserts, since the caller is part of the product; reading never does, since any peer may be the sender. A
//! variable integer has seven bits a byte, low bits first, and only its shortest form is accepted (PROTOCOL 2.2).

use alloc::vec::Vec;

use super::Malformed;
use crate::limits::COUNT_MAX;

/// Appends values to a buffer.
#[derive(Debug, Default)]
pub struct Writer {
    buffer: Vec<u8>,
}

impl Writer {
    /// An empty buffer.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// An empty buffer with capacity for this many bytes.
    #[must_use]
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        Self {
            buffer: Vec::with_capacity(bytes),
        }
    }

    /// Empties it; its memory stays for other values.
    pub fn clear(&mut self) {
        self.buffer.clear();
    }

    /// The bytes written so far.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.buffer
    }

    /// The written bytes.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.buffer
    }

    /// Number of bytes written.
    #[must_use]
    pub fn len(&self) -> usize {
        self.buffer.len()
    }

    /// True if nothing was written.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.buffer.is_empty()
    }

    /// One byte.
    pub fn u8(&mut self, value: u8) {
        self.buffer.push(value);
    }

    /// Two bytes, little-endian.
    pub fn u16(&mut self, value: u16) {
        self.buffer.extend_from_slice(&value.to_le_bytes());
    }

    /// A variable integer of one to ten bytes.
    pub fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.buffer.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.buffer.push(value as u8);
    }

    /// The four bytes of a float, little-endian.
    pub fn f32(&mut self, value: f32) {
        self.buffer.extend_from_slice(&value.to_le_bytes());
    }

    /// Floats, one after the other.
    pub fn f32s(&mut self, values: &[f32]) {
        for value in values {
            self.f32(*value);
        }
    }

    /// The bytes unchanged.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// A length as a variable integer, then the bytes.
    pub fn sized(&mut self, bytes: &[u8]) {
        self.varint(bytes.len() as u64);
        self.raw(bytes);
    }
}

/// Takes values off the front of a slice.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// Reads from the start of `bytes`.
    #[must_use]
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The unread bytes.
    #[must_use]
    pub const fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    ///
    /// [`Malformed::Truncated`] when fewer are left; so for every method below.
    pub fn raw(&mut self, count: usize) -> Result<&'a [u8], Malformed> {
        let (taken, rest) = self
            .rest
            .split_at_checked(count)
            .ok_or(Malformed::Truncated)?;
        self.rest = rest;
        Ok(taken)
    }

    /// The next `N` bytes.
    ///
    /// # Errors
    ///
    /// As [`Self::raw`].
    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or(Malformed::Truncated)?;
        self.rest = rest;
        Ok(*taken)
    }

    /// One byte.
    ///
    /// # Errors
    ///
    /// As [`Self::raw`].
    pub fn u8(&mut self) -> Result<u8, Malformed> {
        self.array::<1>().map(|[byte]| byte)
    }

    /// Two bytes, little-endian.
    ///
    /// # Errors
    ///
    /// As [`Self::raw`].
    pub fn u16(&mut self) -> Result<u16, Malformed> {
        self.array().map(u16::from_le_bytes)
    }

    /// A variable integer.
    ///
    /// # Errors
    ///
    /// [`Malformed::NotCanonical`] for a longer form than needed, [`Malformed::OutOfRange`] beyond 64 bits.
    pub fn varint(&mut self) -> Result<u64, Malformed> {
        let mut value = 0_u64;
        for place in 0..10 {
            let byte = self.u8()?;
            let bits = u64::from(byte & 0x7f);
            if place == 9 && bits > 1 {
                return Err(Malformed::OutOfRange);
            }
            value |= bits << (7 * place);
            if byte & 0x80 == 0 {
                let shortest = byte != 0 || place == 0;
                return if shortest {
                    Ok(value)
                } else {
                    Err(Malformed::NotCanonical)
                };
            }
        }
        Err(Malformed::OutOfRange)
    }

    /// A variable integer of at most `most`.
    ///
    /// # Errors
    ///
    /// As [`Self::varint`], and [`Malformed::OutOfRange`] above `most`.
    pub(crate) fn varint_to(&mut self, most: u64) -> Result<u64, Malformed> {
        let value = self.varint()?;
        if value > most {
            return Err(Malformed::OutOfRange);
        }
        Ok(value)
    }

    /// A tick or another count that only grows, of at most [`COUNT_MAX`].
    ///
    /// # Errors
    ///
    /// As `varint_to`.
    pub fn count(&mut self) -> Result<u64, Malformed> {
        self.varint_to(COUNT_MAX)
    }

    /// A variable integer that fits 32 bits.
    ///
    /// # Errors
    ///
    /// As `varint_to`.
    pub fn varint32(&mut self) -> Result<u32, Malformed> {
        self.varint_to(u64::from(u32::MAX))
            .map(|value| value as u32)
    }

    /// A float of any value.
    ///
    /// # Errors
    ///
    /// As [`Self::raw`].
    pub fn f32(&mut self) -> Result<f32, Malformed> {
        self.array().map(f32::from_le_bytes)
    }

    /// `N` floats.
    ///
    /// # Errors
    ///
    /// As [`Self::raw`].
    pub fn f32s<const N: usize>(&mut self) -> Result<[f32; N], Malformed> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f32()?;
        }
        Ok(values)
    }

    /// A length of at most `most`, then as many bytes.
    ///
    /// # Errors
    ///
    /// [`Malformed::TooLong`] above `most`.
    pub fn sized(&mut self, most: usize) -> Result<&'a [u8], Malformed> {
        let length = self.varint()?;
        if length > most as u64 {
            return Err(Malformed::TooLong);
        }
        self.raw(length as usize)
    }

    /// Ends reading.
    ///
    /// # Errors
    ///
    /// [`Malformed::Trailing`] when bytes are left.
    pub fn finish(self) -> Result<(), Malformed> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(Malformed::Trailing)
        }
    }
}

/// Peers must tolerate unknown codes from here on; the item of each code tells how (PROTOCOL 3.5).
pub const OPTIONAL: u8 = 0x80;

/// A value with exactly one encoding in whole bytes.
pub trait Wire: Sized {
    /// Appends the value's encoding.
    fn encode(&self, to: &mut Writer);

    /// Takes a value off the front.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when the front is not the encoding of a value of this type.
    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed>;
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_variable_integer_round_trips(value: u64) {
            let mut writer = Writer::new();
            writer.varint(value);
            let bytes = writer.into_bytes();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(reader.varint(), Ok(value));
            prop_assert_eq!(reader.finish(), Ok(()));
            for cut in 0..bytes.len() {
                prop_assert_eq!(Reader::new(&bytes[..cut]).varint(), Err(Malformed::Truncated));
            }
        }

        #[test]
        fn varint_decode_then_encode_is_identity(bytes in proptest::collection::vec(any::<u8>(), 0..12)) {
            let mut reader = Reader::new(&bytes);
            if let Ok(value) = reader.varint() {
                let mut writer = Writer::new();
                writer.varint(value);
                prop_assert_eq!(&writer.into_bytes()[..], &bytes[..bytes.len() - reader.rest().len()]);
            }
        }
    }

    #[test]
    fn a_longer_form_is_refused() {
        assert_eq!(
            Reader::new(&[0x80, 0x00]).varint(),
            Err(Malformed::NotCanonical)
        );
        assert_eq!(
            Reader::new(&[0xff; 10]).varint(),
            Err(Malformed::OutOfRange)
        );
    }
}
