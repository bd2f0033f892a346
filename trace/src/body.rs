//! Bodies as traces have them.

use rhumb_protocol::scene::{BodyDesc, Shape};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Inertia, Tick};

/// A body and its initial state.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The body is placed before the step that follows this tick.
    pub tick: Tick,
    /// Its descriptor.
    pub desc: BodyDesc,
    /// Its shape.
    pub shape: Shape,
    /// Its initial state.
    pub observation: Observation,
    /// Its inertia, if it rotates freely and the inertia is known.
    pub inertia: Option<Inertia>,
}

/// A body as it is drawn.
#[derive(Clone, Copy, Debug)]
pub struct DrawnBody<'a> {
    /// The body.
    pub id: BodyId,
    /// Its shape.
    pub shape: &'a Shape,
    /// Centre of mass, world frame, metres.
    pub position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// True if the body is at rest.
    pub still: bool,
}
