//! A body that needs an update, and what is known of it and of its stream.
//!
//! Data alone: it decides nothing.

use rhumb_reckoning::{Divergence, Metres, Motion, Pose, Tick, Ticks, Tolerance, Track};

use crate::stream::features::Features;
use crate::stream::tracks::{Slot, Tracks};

/// What is known of a body that needs an update.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The track that no longer holds.
    pub(crate) track: &'a Track,
    /// The published tick.
    pub(crate) tick: Tick,
    /// The body's motion then, and the predicted one.
    pub(crate) truth: Motion,
    pub(crate) predicted_motion: Motion,
    /// Its motion one and two ticks before.
    pub(crate) last: [Option<Motion>; 2],
    /// Its motion one and two strides before.
    pub(crate) past: [Option<Motion>; 2],
    /// Ticks between two observations before the published tick.
    pub(crate) stride: Ticks,
    /// Its motions in the next ticks, as far as lookahead knows.
    pub(crate) ahead: &'a [Motion],
    /// Whether it is known that nothing is seen of it after that.
    pub(crate) ends: bool,
    /// The body that it may be attached to.
    pub(crate) parent: Option<Parent<'a>>,
}

/// A body that another may be attached to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parent<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// Its motion at the published tick.
    pub(crate) truth: Motion,
    /// Its motion one and two strides of the child before.
    pub(crate) past: [Option<Motion>; 2],
    /// Its motions in the next ticks.
    pub(crate) ahead: &'a [Motion],
}

/// What a decision of one publisher goes by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Context<'a> {
    pub(crate) tracks: &'a Tracks,
    pub(crate) features: Features,
    /// Factor on the tolerances by which lifetimes are estimated: more than one where a budget does not suffice, less for
    /// bodies that others are attached to.
    pub(crate) slack: f64,
}

/// How much of the tolerance lies between two poses of a body.
pub(crate) fn share(
    truth: &Pose,
    predicted_motion: &Pose,
    tolerance: Tolerance,
    radius: Metres,
) -> f64 {
    tolerance.share(&Divergence::between(truth, predicted_motion), radius)
}
