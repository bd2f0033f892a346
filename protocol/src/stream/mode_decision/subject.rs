//! Inputs of the mode decision: one body, and the state of its stream.
//!
//! Contains data alone, no decision.

use glam::DVec3;
use rhumb_reckoning::{BodyState, Divergence, Metres, Motion, Pose, Tick, Ticks, Tolerance, Track};

use super::errors::Errors;
use crate::stream::features::Features;
use crate::stream::tracks::{Slot, Tracks};

/// A body that needs an update, with its observations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The track that no longer holds.
    pub(crate) track: &'a Track,
    /// The published tick.
    pub(crate) tick: Tick,
    /// The body's true motion at that tick.
    pub(crate) truth: &'a Motion,
    /// The body's predicted motion at that tick.
    pub(crate) predicted_motion: &'a Motion,
    /// The same in the frame of the track.
    pub(crate) framed: &'a Motion,
    /// The true linear velocities one and two ticks before, m/s.
    pub(crate) velocities: Option<[DVec3; 2]>,
    /// The observed states one and two strides before.
    pub(crate) past: &'a [Option<&'a BodyState>; 2],
    /// Ticks between two observations before the published tick.
    pub(crate) stride: Ticks,
    /// The true motions of the next ticks, as far as the lookahead reaches.
    pub(crate) ahead: &'a [Motion],
    /// True if the body has no observations after those.
    pub(crate) ends: bool,
    /// A body that this body may be attached to.
    pub(crate) parent: Option<Parent<'a>>,
}

impl Subject<'_> {
    /// Difference of the true and the predicted velocities, in m/s and rad/s.
    pub(super) fn velocity_error(&self) -> Errors {
        let (truth, predicted) = (self.truth.twist(), self.predicted_motion.twist());
        Errors::of([
            truth.linear - predicted.linear,
            truth.angular - predicted.angular,
        ])
    }
}

/// A possible parent, with its observations.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Parent<'a> {
    pub(crate) index: u32,
    pub(crate) slot: &'a Slot,
    /// The true motion at the published tick.
    pub(crate) truth: &'a Motion,
    /// The predicted motion in the frame of its track.
    pub(crate) predicted_motion: &'a Motion,
    /// The observed states one and two strides of the child before.
    pub(crate) past: Option<&'a [Option<BodyState>; 2]>,
    /// The true motions of the next ticks.
    pub(crate) ahead: &'a [Motion],
}

/// State of the publisher that a decision depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Context<'a> {
    pub(crate) tracks: &'a Tracks,
    pub(crate) features: Features,
    /// Factor on the tolerances in lifetime estimates: above one if the budget does not suffice, below one for parents.
    pub(crate) slack: f64,
}

/// Share of the tolerance that the difference of two poses of a body takes.
pub(crate) fn share(
    truth: &Pose,
    predicted_motion: &Pose,
    tolerance: Tolerance,
    radius: Metres,
) -> f64 {
    tolerance.share(&Divergence::between(truth, predicted_motion), radius)
}
