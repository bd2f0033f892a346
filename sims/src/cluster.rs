//! Places for many bodies close together that do not overlap.
//!
//! A cubic quantiser filled layer by layer from below, each place off its quantiser point by chance.

use glam::Vec3;

use crate::rng::SceneRng;

/// A cube of places around a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cluster {
    /// The cube's middle; it is raised where the cube would reach below `lowest`.
    pub(crate) centre: Vec3,
    /// Least height of a place, metres.
    pub(crate) lowest: f32,
    /// Between neighbouring quantiser points, metres.
    pub(crate) spacing: f32,
    /// Farthest from the quantiser point along each axis, metres.
    pub(crate) jitter: f32,
}

impl Cluster {
    /// So many places; neighbours are at least `spacing − 2·jitter` apart.
    pub(crate) fn places(self, count: u32, rng: &mut SceneRng) -> impl Iterator<Item = Vec3> {
        let side = (1..).find(|side: &u32| side.pow(3) >= count).unwrap_or(1);
        let half = (side - 1) as f32 * self.spacing * 0.5;
        let bottom = (self.centre.y - half).max(self.lowest + self.jitter);
        let corner = Vec3::new(self.centre.x - half, bottom, self.centre.z - half);
        (0..count).map(move |place| {
            let (x, z, y) = (place % side, place / side % side, place / (side * side));
            let quantiser = Vec3::new(x as f32, y as f32, z as f32) * self.spacing;
            corner + quantiser + rng.vector() * self.jitter
        })
    }
}
