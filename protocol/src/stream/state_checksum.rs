//! The checksum over all tracks, which publisher and subscriber compare.
//!
//! Kept up to date at the cost of what changes. Does not show which track differs (PROTOCOL 6.12).

use rhumb_reckoning::{Anchor, BodyId, Track};

use crate::packet::predictor_code;

/// The sum of the hashes of bodies' tracks, modulo 2⁶⁴; independent of their order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct StateChecksum(u64);

impl StateChecksum {
    /// The checksum as a number.
    pub(crate) const fn value(self) -> u64 {
        self.0
    }

    /// Adds the track of a body.
    pub(crate) fn add(&mut self, id: BodyId, track: &Track) {
        self.0 = self.0.wrapping_add(checksums(id, track));
    }

    /// Removes the track of a body.
    pub(crate) fn take(&mut self, id: BodyId, track: &Track) {
        self.0 = self.0.wrapping_sub(checksums(id, track));
    }
}

/// An odd factor with evenly spread bits: the golden ratio in 64 bits. Source: Steele, Lea and Flood (2014),
/// SplitMix64.
const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

/// Mixes one word into a hash (PROTOCOL 6.12).
const fn mix(so_far: u64, word: u64) -> u64 {
    let product = (so_far ^ word).wrapping_mul(FACTOR);
    product ^ (product >> 32)
}

/// Two integers as one word.
const fn pair(low: i32, high: i32) -> u64 {
    (low as u32) as u64 | ((high as u32) as u64) << 32
}

/// The hash of a body's id and its whole track.
fn checksums(id: BodyId, track: &Track) -> u64 {
    let Track {
        origin,
        predictor,
        anchor,
        parent,
    } = *track;
    let mut sum = mix(FACTOR, pair(id.index() as i32, i32::from(id.generation())));
    sum = mix(sum, origin.value());
    if let Some(parent) = parent {
        let (index, generation) = (parent.index(), parent.generation());
        sum = mix(sum, pair(index as i32, i32::from(generation)));
    }
    match &anchor {
        Anchor::Exact(motion) => {
            sum = mix(sum, 2 * u64::from(predictor_code(predictor)) + 1);
            for parts in motion.parts().chunks(2) {
                let bits = |place: usize| parts.get(place).map_or(0, |part| part.to_bits() as i32);
                sum = mix(sum, pair(bits(0), bits(1)));
            }
        }
        Anchor::Quantised(motion) => {
            sum = mix(sum, 2 * u64::from(predictor_code(predictor)));
            let [x, y, z] = motion.position;
            let (largest, [a, b, c]) = motion.rotation.parts();
            let [u, v, w] = motion.linear;
            let [p, q, r] = motion.angular;
            for word in [
                pair(x, y),
                pair(z, i32::from(largest)),
                pair(a, b),
                pair(c, u),
                pair(v, w),
                pair(p, q),
                pair(r, 0),
            ] {
                sum = mix(sum, word);
            }
        }
    }
    if let Some(push) = predictor.acceleration() {
        let [x, y, z] = push.steps().map(i32::from);
        sum = mix(mix(sum, pair(x, y)), pair(z, i32::from(push.exponent())));
    }
    sum
}
