//! Mass and moments of inertia of a solid at density one.
//!
//! Around the body's origin, which the protocol places at the centre of mass. Invariant: all numbers are normal.

use glam::{Quat, Vec3};
use parry3d::mass_properties::MassProperties;

use crate::parts::SolidPart;

/// Mass and moments of a solid of one kilogram per cubic metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitMass {
    /// Kilograms: its volume.
    pub mass: f32,
    /// About its principal axes, kg·m².
    pub moments: Vec3,
    /// Principal axes → body.
    pub frame: Quat,
}

impl UnitMass {
    /// Of all parts together; `None` for parts without volume, and where a number is too small or too large for f32.
    #[must_use]
    pub fn of(parts: &[SolidPart]) -> Option<Self> {
        let own = |part: &SolidPart| part.shape.mass_properties(1.0).transform_by(&part.at);
        let total: MassProperties = parts.iter().map(own).sum();
        let (mass, moments) = (total.mass(), total.principal_inertia());
        let sound = |value: f32| value.is_normal() && value > 0.0;
        let is_sound = sound(mass) && sound(moments.min_element()) && moments.is_finite();
        is_sound.then_some(Self {
            mass,
            moments,
            frame: total.principal_inertia_local_frame,
        })
    }
}
