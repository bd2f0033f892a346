//! Conversion of shapes to Rapier solids.
//!
//! Invariant: a solid's mass and moments are normal numbers at every allowed density.

use glam::Vec3;
use rapier3d::math::Pose as RapierPose;
use rapier3d::prelude::{
    Aabb, ActiveCollisionTypes, ActiveEvents, Collider, ColliderBuilder, Group, InteractionGroups,
    InteractionTestMode, MassProperties, PhysicsWorld, RigidBodyHandle,
};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Mass, Shape};
use rhumb_solids::SolidPart;

use super::crowding::weight;
use crate::engine::interface::{BodyProperties, UnusableShape};

/// Solid that all bodies of one shape share.
#[derive(Clone)]
pub(super) struct Solid {
    parts: Vec<SolidPart>,
    weighing: Weighing,
    /// Its largest moment of inertia at density one, kg·m²; 0 for a shape without an inside.
    moment: f32,
}

/// Source of a body's mass and moments.
#[derive(Clone, Copy)]
enum Weighing {
    /// Its part's, as the engine computes them.
    Plain,
    /// Its part's, around the origin: a hull is given from its centre of mass, and neither rounding nor a wrong hull
    /// moves it.
    Centred,
    /// The mass of all parts together, at density one.
    Together(MassProperties),
    /// None: no part can be touched.
    Nothing,
}

impl Solid {
    /// True for a half-space, which has no other part.
    pub(super) fn is_half_space(&self) -> bool {
        matches!(self.parts.as_slice(), [part] if part.shape.as_halfspace().is_some())
    }
}

/// The solid of a shape; bodies share it.
///
/// # Errors
///
/// [`UnusableShape`] for a shape without faces, or without normal mass and moments.
pub(super) fn solid(shape: &Shape) -> Result<Solid, UnusableShape> {
    let parts = rhumb_solids::parts(shape).ok_or(UnusableShape)?;
    for part in &parts {
        if part.shape.as_convex_polyhedron().is_some() {
            check(&part.shape.mass_properties(1.0))?;
        }
    }
    let moment = |together: &MassProperties| together.principal_inertia().max_element();
    let (weighing, moment) = match shape {
        Shape::Compound(compound) if compound.parts().is_empty() => (Weighing::Nothing, 0.0),
        _ if !shape.is_solid() => (Weighing::Plain, 0.0),
        Shape::Hull(_) => (Weighing::Centred, moment(&total(&parts))),
        Shape::Compound(_) => {
            let together = total(&parts);
            check(&together)?;
            (Weighing::Together(together), moment(&together))
        }
        _ => (Weighing::Plain, moment(&total(&parts))),
    };
    Ok(Solid {
        parts,
        weighing,
        moment,
    })
}

/// Mass properties of all parts together, at density one.
fn total(parts: &[SolidPart]) -> MassProperties {
    let properties = parts.iter().map(|part| {
        let own = part.shape.mass_properties(1.0);
        own.transform_by(&part.at)
    });
    properties.sum()
}

fn check(properties: &MassProperties) -> Result<(), UnusableShape> {
    let inertia = properties.principal_inertia().min_element();
    let sound = [properties.mass(), inertia]
        .into_iter()
        .all(|value| value.is_normal() && value > 0.0);
    if sound && properties.local_com.is_finite() {
        Ok(())
    } else {
        Err(UnusableShape)
    }
}

/// The colliders of a body with their surface and mass.
pub(super) fn colliders(
    properties: &BodyProperties,
    solid: &Solid,
) -> impl Iterator<Item = Collider> {
    solid.parts.iter().map(move |part| {
        let builder = ColliderBuilder::new(part.shape.clone());
        let mut collider = if part.at == RapierPose::IDENTITY {
            builder.build()
        } else {
            builder.position(part.at).build()
        };
        set_properties(&mut collider, properties, solid);
        collider
    })
}

/// The boxes of the colliders of a body at this pose, and the weights of their pairs.
pub(super) fn boxes(solid: &Solid, at: RapierPose) -> impl Iterator<Item = (Aabb, u64)> {
    let parts = solid.parts.iter();
    parts.map(move |part| {
        let aabb = part.shape.compute_aabb(&(at * part.at));
        (aabb, weight(&*part.shape))
    })
}

/// The kinds of bodies that the colliders of a body meet. A sensor finds kinematic bodies too, though it may be fixed or
/// kinematic itself.
pub(super) fn collision_types(desc: &BodyDesc) -> ActiveCollisionTypes {
    if desc.sensor {
        ActiveCollisionTypes::default()
            | ActiveCollisionTypes::KINEMATIC_FIXED
            | ActiveCollisionTypes::KINEMATIC_KINEMATIC
    } else {
        ActiveCollisionTypes::default()
    }
}

/// The groups of the colliders of a body.
pub(super) const fn groups(desc: &BodyDesc) -> InteractionGroups {
    InteractionGroups::new(
        Group::from_bits_retain(desc.groups.members),
        Group::from_bits_retain(desc.groups.touches),
        InteractionTestMode::And,
    )
}

/// Sets the surface and mass of a collider of a solid.
pub(super) fn set_properties(collider: &mut Collider, properties: &BodyProperties, solid: &Solid) {
    let (desc, material) = (&properties.desc, properties.material);
    collider.set_friction(material.friction);
    collider.set_restitution(material.restitution);
    collider.set_sensor(desc.sensor);
    // Rapier tells of a sensor that a fast body has gone through within a step by its events alone.
    collider.set_active_events(if desc.sensor {
        ActiveEvents::COLLISION_EVENTS
    } else {
        ActiveEvents::empty()
    });
    collider.set_active_collision_types(collision_types(desc));
    collider.set_collision_groups(groups(desc));
    match solid.weighing {
        _ if own_mass(properties).is_some() => collider.set_density(0.0),
        Weighing::Plain => collider.set_density(material.density),
        Weighing::Centred => collider.set_mass_properties(MassProperties {
            local_com: Vec3::ZERO,
            ..collider.shape().mass_properties(material.density)
        }),
        Weighing::Together(_) | Weighing::Nothing => collider.set_density(0.0),
    }
}

/// Sets the surface and mass of a body's colliders, or gives it those of another solid.
pub(super) fn change(
    world: &mut PhysicsWorld,
    body: RigidBodyHandle,
    now: &BodyProperties,
    (solid, is_other): (&Solid, bool),
) {
    let before = world.bodies[body].colliders().to_vec();
    for handle in before {
        if is_other {
            world.remove_collider(handle);
        } else if let Some(collider) = world.colliders.get_mut(handle) {
            set_properties(collider, now, solid);
        }
    }
    if is_other {
        for collider in colliders(now, solid) {
            world.insert_collider(collider, Some(body));
        }
    }
}

/// The mass that a dynamic body has in place of its solid's.
fn own_mass(properties: &BodyProperties) -> Option<Mass> {
    let is_dynamic = properties.desc.kind == BodyKind::Dynamic;
    properties.desc.mass.filter(|_| is_dynamic)
}

/// The largest moment of inertia of a body without a mass of its own.
pub(super) fn moment(properties: &BodyProperties, solid: &Solid) -> Option<f32> {
    let own = own_mass(properties).is_some();
    (!own).then_some(solid.moment * properties.material.density)
}

/// Mass of a body in addition to its colliders'.
pub(super) fn mass_beside(properties: &BodyProperties, solid: &Solid) -> Option<MassProperties> {
    // A body without shape falls too: a kilogram with the moments of a ball of one metre.
    let nothing = MassProperties::new(Vec3::ZERO, 1.0, Vec3::splat(0.4));
    let scaled = |unit: MassProperties, factor: f32| {
        MassProperties::with_principal_inertia_frame(
            Vec3::ZERO,
            unit.mass() * factor,
            unit.principal_inertia() * factor,
            unit.principal_inertia_local_frame,
        )
    };
    if let Some(Mass { mass, moments }) = own_mass(properties) {
        if let Some(moments) = moments {
            return Some(MassProperties::new(Vec3::ZERO, mass, moments));
        }
        let unit = match solid.weighing {
            Weighing::Plain | Weighing::Centred => total(&solid.parts),
            Weighing::Together(unit) => unit,
            Weighing::Nothing => nothing,
        };
        return Some(scaled(unit, mass / unit.mass()));
    }
    match solid.weighing {
        Weighing::Plain | Weighing::Centred => None,
        Weighing::Together(unit) => Some(scaled(unit, properties.material.density)),
        Weighing::Nothing => Some(nothing),
    }
}
