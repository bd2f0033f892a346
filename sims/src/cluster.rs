//! Positions for many bodies close together without overlap.
//!
//! A cubic grid filled layer by layer from below; each position is offset randomly from its grid point.

use glam::Vec3;

use crate::rng::SceneRng;

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
