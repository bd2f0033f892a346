//! Parent candidates: the largest moving bodies of a tick.

use glam::Vec3;

/// The number of parent candidates at one tick: the largest moving bodies.
pub(super) const PARENT_CANDIDATES_MAX: usize = 16;
/// A parent is larger than its child by this factor at least.
pub(super) const PARENT_SIZE_RATIO: f64 = 1.2;

/// A parent candidate at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct LargeBody {
    /// Its position among the observations.
    pub(super) place: usize,
    pub(super) position: Vec3,
    /// The radius, metres.
    pub(super) radius: f64,
}
