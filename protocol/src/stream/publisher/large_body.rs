//! Parent candidates: the largest moving bodies of a tick.

use glam::Vec3;
use rhumb_reckoning::{BodyState, Motion, Ticks};

use super::window::Ahead;

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

/// A parent candidate with its observations, the same for all its possible children.
#[derive(Clone, Debug)]
pub(super) struct ObservedParent {
    pub(super) index: u32,
    pub(super) truth: Motion,
    /// The motion in the frame of its track, after its own update of the tick.
    pub(super) predicted_motion: Motion,
    /// Its states one and two strides before.
    pub(super) past: [Option<BodyState>; 2],
    pub(super) stride: Ticks,
    pub(super) ahead: Option<Ahead>,
}
