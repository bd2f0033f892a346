//! A rotation in sixty-two bits.
//!
//! Knows only its own grid, which is the same for every body. Invariant: one rotation has one form (RECKONING 4.3).

use glam::DQuat;

use crate::exact::{floor_to_i32, normalised, sqrt};

/// A rotation as its three smaller components in steps of 2⁻¹⁹ and the place of the largest, which is positive.
///
/// 62 bits. Error: below 6.7e-6 rad (half a step in each coded component, three halves in the largest), or 9.4e-6 rad
/// where components so nearly tie that a second pass rounds again; 0.94 mm at 100 m from the centre.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PackedRotation {
    /// Low two bits of the first word: the place of the largest component. Then a component of twenty bits, half of
    /// the third, and in the second word the second component and the other half. A table of tracks stays dense.
    words: [u32; 2],
}

/// Steps in one.
pub(crate) const PACKED_STEPS: f64 = 524_288.0;
/// For each place of the greatest component, the places of the others.
const OTHERS: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

impl PackedRotation {
    /// No turn: the fourth component is the largest, the others are zero.
    pub const IDENTITY: Self = Self::packed(3, [0; 3]);
    /// The largest size of one of the smaller components: 2¹⁹/√2, rounded up.
    pub const LIMIT: i32 = 370_728;

    /// The grid point of a unit quaternion (RECKONING 4.3).
    #[must_use]
    pub fn of(rotation: DQuat) -> Self {
        Self::nearest(rotation).stable()
    }

    /// The grid point nearest to components in whole steps.
    pub(crate) fn of_whole(steps: [f64; 4]) -> Self {
        // The cast saturates, far beyond what any component takes.
        Self::of_steps(steps.map(|part| part as i32)).stable()
    }

    /// Repeats the packing until it is a fixed point.
    fn stable(self) -> Self {
        let mut packed = self;
        // If two components tie, rounding may make the other one the largest; the second pass is then stable.
        for _ in 0..3 {
            if packed.is_surely_stable() {
                break;
            }
            let again = Self::nearest(packed.value());
            if again == packed {
                break;
            }
            packed = again;
        }
        packed
    }

    /// True if the largest component is the largest by a whole step in its own value too: then that value packs to
    /// itself. The other components are whole steps up to rounding errors far below half a step.
    fn is_surely_stable(self) -> bool {
        let (_, others) = self.parts();
        let square = |part: i32| i64::from(part) * i64::from(part);
        let sum: i64 = others.iter().copied().map(square).sum();
        let most = others.iter().map(|part| part.abs()).max().unwrap_or(0);
        square(1 << 19) - sum >= square(most + 1)
    }

    fn nearest(rotation: DQuat) -> Self {
        let part = |part: f64| floor_to_i32(part * PACKED_STEPS + 0.5);
        Self::of_steps([
            part(rotation.x),
            part(rotation.y),
            part(rotation.z),
            part(rotation.w),
        ])
    }

    fn of_steps(steps: [i32; 4]) -> Self {
        let most = 1 << 20;
        let steps = steps.map(|part| part.clamp(-most, most));
        let mut largest = 0;
        for i in 1..4 {
            if steps[i].abs() > steps[largest].abs() {
                largest = i;
            }
        }
        let sign = if steps[largest] < 0 { -1 } else { 1 };
        let most = 1 << 19;
        let [a, b, c] = OTHERS[largest];
        let other = |i: usize| (steps[i] * sign).clamp(-most, most - 1);
        Self::packed(largest as u8, [other(a), other(b), other(c)])
    }

    /// Packs a place and components of at most twenty bits.
    const fn packed(largest: u8, [a, b, c]: [i32; 3]) -> Self {
        const MASK: u32 = (1 << 20) - 1;
        let (a, b, c) = (a as u32 & MASK, b as u32 & MASK, c as u32 & MASK);
        Self {
            words: [largest as u32 | a << 2 | c << 22, b | (c >> 10) << 20],
        }
    }

    /// The value in two words.
    #[inline]
    pub(crate) const fn words(self) -> [u32; 2] {
        self.words
    }

    /// The value of words that a checked value gave.
    #[inline]
    pub(crate) const fn from_words(words: [u32; 2]) -> Self {
        Self { words }
    }

    /// Checks decoded parts: `None` unless they are the one encoding of their rotation.
    #[must_use]
    pub fn from_parts(largest: u8, others: [i32; 3]) -> Option<Self> {
        let small = |part: &i32| (-Self::LIMIT..=Self::LIMIT).contains(part);
        let bounded = largest < 4 && others.iter().all(small);
        if !bounded {
            return None;
        }
        let packed = Self::packed(largest, others);
        (packed.is_surely_stable() || Self::nearest(packed.value()) == packed).then_some(packed)
    }

    /// Place of the largest component (x, y, z, w are 0 to 3), and the others in that order.
    #[must_use]
    pub const fn parts(self) -> (u8, [i32; 3]) {
        let [low, high] = self.words;
        let c = (low >> 22) | (high >> 20 << 10);
        // Shifting up and down extends the sign.
        const fn signed(bits: u32) -> i32 {
            (bits << 12) as i32 >> 12
        }
        ((low & 3) as u8, [signed(low >> 2), signed(high), signed(c)])
    }

    /// The unit quaternion of this grid point (RECKONING 4.3).
    #[must_use]
    pub fn value(self) -> DQuat {
        normalised(self.unnormalised())
    }

    /// The same, of unit length up to rounding.
    pub(crate) fn unnormalised(self) -> DQuat {
        let (largest, [a, b, c]) = self.parts();
        let part = |steps: i32| f64::from(steps) / PACKED_STEPS;
        let (a, b, c) = (part(a), part(b), part(c));
        let rest = (1.0 - ((a * a + b * b) + c * c)).max(0.0);
        // Taken from the low two bits, it is a place among four.
        let largest = usize::from(largest & 3);
        let [first, second, third] = OTHERS[largest];
        let mut parts = [0.0; 4];
        parts[largest] = sqrt(rest);
        parts[first] = a;
        parts[second] = b;
        parts[third] = c;
        DQuat::from_array(parts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn stable_rotations_pack_to_themselves(
            largest in 0_u8..4,
            others in proptest::array::uniform3(
                prop_oneof![-400_000_i32..=400_000, 302_000..303_000, 370_000..371_000]
            ),
        ) {
            let packed = PackedRotation::packed(largest, others);
            if packed.is_surely_stable() {
                prop_assert_eq!(PackedRotation::nearest(packed.value()), packed);
            }
        }
    }
}
