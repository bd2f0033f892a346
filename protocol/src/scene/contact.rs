//! A contact of two bodies after a tick, as an engine reports it.

use glam::Vec3;
use rhumb_reckoning::BodyId;

/// Contact of a body with another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The other body.
    pub with: BodyId,
    /// Metres, world frame: on the queried body.
    pub point: Vec3,
    /// From the other body towards the queried one, unit, world frame.
    pub normal: Vec3,
    /// Metres; negative: they overlap.
    pub separation: f32,
}
