//! What an engine says of a body after a tick: the publisher's truth.

use rhumb_reckoning::{BodyId, BodyState};

/// Whether the engine still moves a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Activity {
    /// The engine steps it.
    Awake,
    /// The engine has put it to sleep in this pose, and leaves it alone until something touches it.
    Asleep,
}

/// One body after one tick.
///
/// An engine observes the bodies that are awake and, once, each that fell asleep in this tick, in the order of their
/// ids. A body it does not mention has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Observation {
    /// Which.
    pub id: BodyId,
    /// Where it is, and how it moves: the engine's own bits.
    pub motion: BodyState,
    /// Whether it may move on.
    pub activity: Activity,
}
