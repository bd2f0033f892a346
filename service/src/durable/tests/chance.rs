//! Chance from a seed.

use glam::Vec3;

/// Numbers from a seed.
pub(super) struct Chance(pub(super) u64);

impl Chance {
    pub(super) fn below(&mut self, n: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        ((self.0 >> 33) as usize) % n.max(1)
    }

    pub(super) fn between(&mut self, from: f32, to: f32) -> f32 {
        from + (to - from) * self.below(1_000) as f32 / 1_000.0
    }

    pub(super) fn vector(&mut self, most: f32) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|_| self.between(-most, most)))
    }
}
