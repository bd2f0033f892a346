//! Seeded random numbers for scripts, and places without overlap.
//!
//! PCG integers, converted to f32 by exact steps, so every platform draws the same bits. Many bodies close together
//! stand in a cubic grid filled layer by layer from below; each position is offset randomly from its grid point.

use glam::{Quat, Vec3};
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;

/// A sequence of numbers determined by its seed.
#[derive(Clone, Debug)]
pub(crate) struct SceneRng {
    draws: Pcg32,
}

impl SceneRng {
    /// The generator's stream number; any odd constant works, this is PCG's own example.
    const STREAM: u64 = 0x0a02_bdbf_7bb3_c0a7;

    pub(crate) fn new(seed: u64) -> Self {
        Self {
            draws: Pcg32::new(seed, Self::STREAM),
        }
    }

    /// A number in [−1, 1), a multiple of 2⁻²³.
    pub(crate) fn signed(&mut self) -> f32 {
        (self.draws.next_u32() >> 8) as f32 / 8_388_608.0 - 1.0
    }

    /// Each component in [−1, 1).
    pub(crate) fn vector(&mut self) -> Vec3 {
        let (x, y, z) = (self.signed(), self.signed(), self.signed());
        Vec3::new(x, y, z)
    }

    /// A uniformly distributed point in the unit ball.
    pub(crate) fn in_ball(&mut self) -> Vec3 {
        loop {
            let drawn = self.vector();
            let squared: f64 = drawn
                .to_array()
                .map(|part| f64::from(part) * f64::from(part))
                .iter()
                .sum();
            if squared <= 1.0 {
                return drawn;
            }
        }
    }

    /// A number below `count`, which must not be zero.
    pub(crate) fn below(&mut self, count: u32) -> u32 {
        ((u64::from(self.draws.next_u32()) * u64::from(count)) >> 32) as u32
    }

    /// A unit quaternion; its distribution is not uniform, which scripts do not need.
    pub(crate) fn rotation(&mut self) -> Quat {
        let axis = self.vector();
        // The constant real part keeps the length away from zero. Square root and division round alike everywhere.
        let [x, y, z, w] = [axis.x, axis.y, axis.z, 0.25].map(f64::from);
        let length = libm::sqrt(x * x + y * y + z * z + w * w);
        let [x, y, z, w] = [x, y, z, w].map(|part| (part / length) as f32);
        Quat::from_xyzw(x, y, z, w)
    }
}

/// A cube of positions around a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cluster {
    /// Centre of the cube; it is raised if the cube would reach below `lowest`.
    pub(crate) centre: Vec3,
    /// Least height of a position, metres.
    pub(crate) lowest: f32,
    /// Spacing of the grid, metres.
    pub(crate) spacing: f32,
    /// Largest offset from the grid point along each axis, metres.
    pub(crate) jitter: f32,
}

impl Cluster {
    /// `count` positions; neighbours are at least `spacing − 2·jitter` apart.
    pub(crate) fn places(self, count: u32, rng: &mut SceneRng) -> impl Iterator<Item = Vec3> {
        let side = (1..).find(|side: &u32| side.pow(3) >= count).unwrap_or(1);
        let half = (side - 1) as f32 * self.spacing * 0.5;
        let bottom = (self.centre.y - half).max(self.lowest + self.jitter);
        let corner = Vec3::new(self.centre.x - half, bottom, self.centre.z - half);
        (0..count).map(move |place| {
            let (x, z, y) = (place % side, place / side % side, place / (side * side));
            let grid_point = Vec3::new(x as f32, y as f32, z as f32) * self.spacing;
            corner + grid_point + rng.vector() * self.jitter
        })
    }
}
