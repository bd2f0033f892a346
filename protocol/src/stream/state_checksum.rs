//! The checksum over all tracks, which publisher and subscriber compare.
//!
//! Does not show which track differs (PROTOCOL 6.12). A track that changes many times between two readings is hashed
//! once before and once after. Invariant: `sum` covers exactly the tracks of the bodies that are not in `changed`.

use alloc::vec::Vec;

use rhumb_reckoning::{Anchor, BodyId, Track};

use crate::interner::grow_to;
use crate::packet::predictor_code;

/// The sum of the hashes of bodies' tracks, modulo 2⁶⁴; independent of their order.
#[derive(Clone, Debug, Default)]
pub(crate) struct StateChecksum {
    /// Over the bodies whose tracks have not changed since the last call of [`Self::settle`].
    sum: u64,
    /// The other bodies: one bit for each index, 64 indices in a word.
    changed: Vec<u64>,
}

impl StateChecksum {
    /// Notes that the track of an index is about to change, appear or go. `before`: the body and track that it has
    /// until then, if there is one.
    pub(crate) fn change(&mut self, index: u32, before: impl FnOnce() -> Option<(BodyId, Track)>) {
        let (word, bit) = (index as usize / 64, 1 << (index % 64));
        grow_to(&mut self.changed, word + 1, || 0);
        if self.changed[word] & bit != 0 {
            return;
        }
        self.changed[word] |= bit;
        if let Some((id, track)) = before() {
            self.sum = self.sum.wrapping_sub(hash(id, &track));
        }
    }

    /// The checksum. `track`: the body and track that an index has now.
    pub(crate) fn value(&self, track: impl Fn(u32) -> Option<(BodyId, Track)>) -> u64 {
        let mut sum = self.sum;
        for (first, word) in (0..).step_by(64).zip(&self.changed) {
            let mut left = *word;
            while left != 0 {
                if let Some((id, track)) = track(first + left.trailing_zeros()) {
                    sum = sum.wrapping_add(hash(id, &track));
                }
                left &= left - 1;
            }
        }
        sum
    }

    /// The same; the next reading then hashes only what changes from now on.
    pub(crate) fn settle(&mut self, track: impl Fn(u32) -> Option<(BodyId, Track)>) -> u64 {
        self.sum = self.value(track);
        self.changed.fill(0);
        self.sum
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
fn hash(id: BodyId, track: &Track) -> u64 {
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

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;

    use proptest::prelude::*;
    use rhumb_reckoning::{BodyState, Tick};

    use super::*;

    fn track(origin: u64) -> Track {
        let rotation = [0.0, 0.0, 0.0, 1.0];
        let motion = BodyState::new([0.0; 3], rotation, [0.0; 3], [0.0; 3]).unwrap();
        Track::resting(Tick::new(origin), motion)
    }

    proptest! {
        /// Each step gives an index a track or takes it away, and may settle the sum.
        #[test]
        fn the_checksum_is_that_of_the_present_tracks_whenever_it_is_settled(
            steps in proptest::collection::vec((proptest::sample::select(&[0_u32, 1, 63, 64, 200][..]), proptest::option::of(0_u64..9), any::<bool>()), 0..60),
        ) {
            let (mut tracks, mut checksum) = (BTreeMap::new(), StateChecksum::default());
            for (index, origin, settles) in steps {
                checksum.change(index, || tracks.get(&index).copied());
                match origin {
                    Some(origin) => tracks.insert(index, (BodyId::new(index, 0), track(origin))),
                    None => tracks.remove(&index),
                };
                let mut new = StateChecksum::default();
                tracks.keys().for_each(|index| new.change(*index, || None));
                let at = |index| tracks.get(&index).copied();
                prop_assert_eq!(checksum.value(at), new.value(at));
                if settles {
                    prop_assert_eq!(checksum.settle(at), new.value(at));
                }
            }
        }
    }
}
