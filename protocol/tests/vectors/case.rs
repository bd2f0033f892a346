//! A case of the vectors, and the seeded random generator of cases.

use rhumb_reckoning::PackedRotation;

/// The name of a case and its datagram.
pub(crate) type NamedPacket = (String, Vec<u8>);

/// A generator with the same numbers on every platform: 64-bit xorshift.
pub(crate) struct PacketRng(u64);

impl PacketRng {
    pub(crate) const fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number below `end`.
    pub(crate) const fn below(&mut self, end: u32) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 32) % end as u64) as u32
    }

    /// A number of at most `most` in size, each order of magnitude equally likely, with a random sign.
    pub(crate) const fn signed(&mut self, most: u32) -> i32 {
        let bits = self.below(33 - most.leading_zeros());
        let size = self.below(1 << bits);
        let size = if size > most { most } else { size } as i32;
        if self.below(2) == 0 { size } else { -size }
    }

    pub(crate) fn triple(&mut self, most: u32) -> [i32; 3] {
        core::array::from_fn(|_| self.signed(most))
    }

    pub(crate) fn rotation(&mut self) -> PackedRotation {
        loop {
            let largest = self.below(4) as u8;
            let others = self.triple(300_000);
            if let Some(rotation) = PackedRotation::from_parts(largest, others) {
                return rotation;
            }
        }
    }
}
