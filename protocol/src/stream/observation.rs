//! The observed state of a body after a tick: the publisher's ground truth.

use rhumb_reckoning::{BodyId, BodyState};

/// The engine's state of a body: stepped, or asleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// The engine steps the body.
    Awake,
    /// The engine has put the body to sleep in this pose and does not move it until something touches it.
    Asleep,
}

/// The state of one body after one tick.
///
/// An engine reports the bodies that are awake and, once, each that fell asleep in this tick, in order of id. A body
/// without an observation has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observation {
    /// The observed body.
    pub id: BodyId,
    /// Its state, the engine's own bits.
    pub motion: BodyState,
    /// The engine's state of the body.
    pub activity: Activity,
}
