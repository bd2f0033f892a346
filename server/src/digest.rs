//! Digest of all observations of a scene.
//!
//! Equal digests mean runs that are equal to the bit. It serves comparison only and is no signature. It depends on
//! observations alone, so that a trace reproduces it, and on integers alone, so that every platform and language does.

use core::fmt;

use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::Tick;

/// The digest of a run up to a tick.
///
/// State: 64 bits, at first [`Digest::START`]. A word w of 32 bits is folded by `s = (s xor w) · K mod 2⁶⁴`, then
/// `s = s xor (s >> 32)`, with K = 0x9e37_79b9_7f4a_7c15 (2⁶⁴ divided by the golden ratio, odd). A tick folds, in this
/// order: the lower and the upper half of its number, the count of observations; then for each observation, in the
/// order of ids: index, generation, the bits of its thirteen f32 (position x y z, quaternion x y z w, linear x y z,
/// angular x y z), and 1 if it is awake, 0 if it fell asleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Digest(u64);

impl Digest {
    /// The digest before the first tick.
    pub const START: Self = Self(0x7268_756d_6220_7631);

    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

    /// Folds in the observations after a tick.
    pub fn fold_tick(&mut self, tick: Tick, observations: &[Observation]) {
        self.fold(tick.value() as u32);
        self.fold((tick.value() >> 32) as u32);
        self.fold(observations.len() as u32);
        for observation in observations {
            self.fold(observation.id.index());
            self.fold(u32::from(observation.id.generation()));
            for part in observation.motion.parts() {
                self.fold(part.to_bits());
            }
            self.fold(match observation.activity {
                Activity::Awake => 1,
                Activity::Asleep => 0,
            });
        }
    }

    /// The digest of a run that continues from a snapshot.
    #[must_use]
    pub const fn from_value(value: u64) -> Self {
        Self(value)
    }

    /// The digest as a number.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }

    const fn fold(&mut self, word: u32) {
        let mixed = (self.0 ^ word as u64).wrapping_mul(Self::FACTOR);
        self.0 = mixed ^ (mixed >> 32);
    }
}

impl Default for Digest {
    fn default() -> Self {
        Self::START
    }
}

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::{BodyId, BodyState};

    use super::*;

    fn observation(x: f32) -> Observation {
        let motion = BodyState::new([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Observation {
            id: BodyId::new(7, 1),
            motion: motion.unwrap(),
            activity: Activity::Awake,
        }
    }

    fn digest(tick: u64, observations: &[Observation]) -> u64 {
        let mut digest = Digest::START;
        digest.fold_tick(Tick::new(tick), observations);
        digest.value()
    }

    #[test]
    fn every_word_changes_the_digest() {
        let one = digest(1, &[observation(1.0)]);
        assert_ne!(one, digest(2, &[observation(1.0)]));
        assert_ne!(one, digest(1, &[observation(-1.0)]));
        assert_ne!(
            digest(1, &[observation(0.0)]),
            digest(1, &[observation(-0.0)])
        );
        let asleep = Observation {
            activity: Activity::Asleep,
            ..observation(1.0)
        };
        assert_ne!(one, digest(1, &[asleep]));
        assert_ne!(digest(1, &[]), digest(2, &[]));
    }

    #[test]
    fn the_digest_equals_its_definition() {
        // Computed by another program from the definition above.
        assert_eq!(digest(1, &[]), 0x4c6d_e8a6_4caa_b305);
        assert_eq!(digest(1, &[observation(1.0)]), 0xc837_96b8_99c9_1bed);
    }
}
