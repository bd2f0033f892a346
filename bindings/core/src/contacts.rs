//! Two bodies that touch, in the coordinates of the application.

use glam::Vec3;
use rhumb_client::{BodyId, Tick, TouchingPair};

use crate::coordinates::Coordinates;

/// Two bodies that touch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactRecord {
    /// The body that was asked for, or that with the lesser id.
    pub body: BodyId,
    /// The body that it touches.
    pub other: BodyId,
    /// A point of the deepest contact, on the body with the lesser id.
    pub point: Vec3,
    /// From the other body towards the body, unit.
    pub normal: Vec3,
    /// Units of length; negative if the bodies overlap.
    pub separation: f32,
    /// The sum of all forces between the bodies.
    pub force: f32,
    /// The tick of the last event about the pair.
    pub tick: Tick,
}

impl ContactRecord {
    pub(crate) fn new(pair: &TouchingPair, coordinates: Coordinates) -> Self {
        let contact = coordinates.contact_out(pair.contact);
        Self {
            body: pair.body,
            other: contact.with,
            point: contact.point,
            normal: contact.normal,
            separation: contact.separation,
            force: contact.force,
            tick: pair.tick,
        }
    }
}
