//! Grease: meaningless values that keep peers tolerant of unknown ones.
//!
//! Every peer must ignore them (PROTOCOL 3.5). A seed determines the values.

use alloc::vec::Vec;

use super::extensions::{Extension, Extensions};
use super::frame::frame;

/// Seeded random numbers for grease: xorshift of 64 bits, multiplied.
///
/// Source: Vigna, "An experimental exploration of Marsaglia's xorshift generators, scrambled", 2016, section 5.
#[derive(Clone, Debug)]
pub struct Grease(u64);

impl Grease {
    /// The random numbers of one connection.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        // Neighbouring seeds diverge at once; zero, which the generator cannot leave, results from one seed only.
        match seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15) {
            0 => Self(1),
            state => Self(state),
        }
    }

    /// The versions in `known` with a reserved one at a random place.
    #[must_use]
    pub fn versions(&mut self, known: &[u16]) -> Vec<u16> {
        let mut versions = known.to_vec();
        let place = self.below(versions.len() as u32 + 1) as usize;
        let nibble = self.below(16) as u16;
        versions.insert(place, nibble * 0x1010 + 0x0a0a);
        versions
    }

    /// One extension that peers skip.
    #[must_use]
    pub fn extensions(&mut self) -> Extensions {
        let mut extensions = Extensions::NONE;
        let id = FIRST + STRIDE * self.below(1 << 20);
        let value = self.bytes();
        let fits = extensions.insert(Extension { id, value });
        debug_assert!(fits, "one short value always fits");
        extensions
    }

    /// Appends a message that peers ignore, every second time.
    pub fn message(&mut self, to: &mut Vec<u8>) {
        if self.below(2) == 0 {
            let kind = 0x8a + 0x10 * self.below(8) as u8;
            frame(kind, &self.bytes(), to);
        }
    }

    fn bytes(&mut self) -> Vec<u8> {
        let length = self.below(9);
        (0..length).map(|_| self.below(256) as u8).collect()
    }

    /// A number below `end`.
    const fn below(&mut self, end: u32) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        let mixed = self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 32;
        ((mixed * end as u64) >> 32) as u32
    }
}

/// Numbers of reserved extensions: this one and each `STRIDE`-th from it on, all odd.
const FIRST: u32 = 27;
/// See [`FIRST`].
const STRIDE: u32 = 62;

/// True if a version is reserved and has no meaning.
#[must_use]
pub const fn is_no_version(version: u16) -> bool {
    version & 0x0f0f == 0x0a0a && version >> 12 == (version >> 4) & 0xf
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::{ClientMessage, Frames, ServerMessage, VERSIONS};

    #[test]
    fn grease_values_lie_in_the_reserved_range() {
        for seed in 0..2_000 {
            let mut grease = Grease::new(seed);
            let versions = grease.versions(&VERSIONS);
            let (none, known): (Vec<u16>, Vec<u16>) = versions
                .iter()
                .partition(|version| is_no_version(**version));
            assert_eq!((none.len(), &known[..]), (1, &VERSIONS[..]));
            let extensions = grease.extensions();
            assert!(!extensions.has_unknown_critical());
            assert!(extensions.iter().all(|one| one.id % STRIDE == FIRST));
        }
    }

    #[test]
    fn grease_messages_are_skipped_by_both_peers() {
        let mut sent = 0;
        for seed in 0..200 {
            let mut bytes = Vec::new();
            Grease::new(seed).message(&mut bytes);
            let mut frames = Frames::new();
            frames.push(&bytes);
            while let Some(framed) = frames.next_frame().unwrap() {
                assert_eq!(framed.kind & 0x8f, 0x8a);
                assert_eq!(ClientMessage::decode(&framed), Ok(None));
                assert_eq!(ServerMessage::decode(&framed), Ok(None));
                sent += 1;
            }
        }
        assert!((60..140).contains(&sent), "{sent} of 200");
    }

    #[test]
    fn no_supported_version_is_reserved() {
        assert!(!VERSIONS.iter().any(|version| is_no_version(*version)));
        let aside = (0..=u16::MAX).filter(|version| is_no_version(*version));
        assert_eq!(aside.count(), 16);
    }
}
