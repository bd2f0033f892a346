//! Masses and moments of bodies, for engines that do not weigh shapes.
//!
//! Invariant: a body that has a mass and moments of its own has them about its own axes; any other has those of its shape.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, LockedAxes};
use rhumb_reckoning::Inertia;
use rhumb_solids::UnitMass;

use super::interface::BodyProperties;

/// Mass, principal moments, and their axes: kg, kg·m², principal axes → body.
pub(super) fn mass_of(properties: &BodyProperties, unit: Option<UnitMass>) -> (f32, Vec3, Quat) {
    let own = properties.desc.mass;
    if let Some((mass, moments)) = own.and_then(|own| Some((own.mass, own.moments?))) {
        return (mass, moments, Quat::IDENTITY);
    }
    let Some(unit) = unit else {
        // A body without shape falls too: a kilogram with the moments of a ball of one metre.
        let factor = own.map_or(1.0, |own| own.mass);
        return (factor, Vec3::splat(0.4 * factor), Quat::IDENTITY);
    };
    let density = own.map_or(properties.material.density, |own| own.mass / unit.mass);
    let mass = own.map_or(unit.mass * density, |own| own.mass);
    (mass, unit.moments * density, unit.frame)
}

/// Moments of inertia of a body, if it rotates torque-free with unequal ones.
pub(super) fn inertia(properties: &BodyProperties, unit: Option<UnitMass>) -> Option<Inertia> {
    let desc = &properties.desc;
    if desc.kind != BodyKind::Dynamic || desc.locked != LockedAxes::NONE || !desc.gyroscopic {
        return None;
    }
    let (_, moments, frame) = mass_of(properties, unit);
    let inertia = Inertia::new(moments.to_array(), frame.to_array()).ok()?;
    (!inertia.is_isotropic()).then_some(inertia)
}
