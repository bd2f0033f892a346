//! A contact of two bodies after a tick, as an engine reports it.

use glam::Vec3;
use rhumb_reckoning::BodyId;

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Contact of a body with another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The other body.
    pub with: BodyId,
    /// Metres, world frame: on the first body.
    pub point: Vec3,
    /// From the other body towards the first one, unit, world frame.
    pub normal: Vec3,
    /// Metres; negative: they overlap.
    pub separation: f32,
    /// Newtons: sum of the sizes of all forces between the two bodies in the last step.
    pub force: f32,
}

impl Wire for Contact {
    fn encode(&self, to: &mut Writer) {
        self.with.encode(to);
        to.f32s(&self.point.to_array());
        to.f32s(&self.normal.to_array());
        to.f32s(&[self.separation, self.force]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let with = BodyId::decode(from)?;
        let [point, normal] = [from.f32s()?, from.f32s()?].map(Vec3::from_array);
        let [separation, force] = from.f32s()?;
        let numbers = [separation, force];
        if !point.is_finite() || !normal.is_finite() || !numbers.iter().all(|n| n.is_finite()) {
            return Err(Malformed::NotFinite);
        }
        Ok(Self {
            with,
            point,
            normal,
            separation,
            force,
        })
    }
}
