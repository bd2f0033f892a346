//! FNV-1a of 64 bits: a hash of bytes for comparisons.
//!
//! It is not cryptographic.

use rhumb_reckoning::Motion;

/// The hash of the bytes so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fnv(u64);

impl Fnv {
    /// The hash of no bytes. Source: Fowler, Noll and Vo, the 64-bit constants.
    pub const START: Self = Self(0xcbf2_9ce4_8422_2325);

    const PRIME: u64 = 0x0000_0100_0000_01b3;

    /// Continues from a hash.
    #[must_use]
    pub const fn from(digest: u64) -> Self {
        Self(digest)
    }

    /// Adds bytes.
    pub fn fold(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(Self::PRIME);
        }
    }

    /// Adds the thirteen doubles of a motion, least significant byte first.
    pub fn fold_motion(&mut self, motion: &Motion) {
        for number in motion.parts() {
            self.fold(&number.to_le_bytes());
        }
    }

    /// The hash as a number.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}
