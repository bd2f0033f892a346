//! Conversion of shapes to Rapier solids.
//!
//! Code that may panic inside Rapier runs on a copy under `catch_unwind`, and nothing of it is kept. Invariant: a
//! solid's mass and moments are normal numbers at every allowed density.

use std::panic::catch_unwind;

use glam::{Quat, Vec3};
use rapier3d::math::Pose as RapierPose;
use rapier3d::parry::utils::Array2;
use rapier3d::prelude::{Collider, ColliderBuilder, MassProperties, SharedShape};
use rhumb_protocol::scene::{Heights, Mesh, Shape};

use super::interface::{NewBody, UnusableShape};
use super::rapier_body::pose;

/// Solid that all bodies of one shape share.
#[derive(Clone)]
pub(super) struct Solid {
    parts: Vec<(RapierPose, SharedShape)>,
    weighing: Weighing,
    /// True if any part of it is thin: fast bodies could pass through it between two steps.
    pub(super) is_sheet: bool,
}

/// Source of a body's mass and moments.
#[derive(Clone, Copy)]
enum Weighing {
    /// Its part's, as the engine computes them.
    Plain,
    /// Its part's, around the origin: a hull is given from its centre of mass, and neither rounding nor a wrong hull
    /// moves it.
    Centred,
    /// Those of all parts together, at density one.
    Together(MassProperties),
    /// None: no part can be touched.
    Nothing,
}

/// The solid of a shape; bodies share it.
///
/// # Errors
///
/// [`UnusableShape`] for a shape without faces, or without normal mass and moments.
pub(super) fn solid(shape: &Shape) -> Result<Solid, UnusableShape> {
    let mut parts = Vec::new();
    add_parts(shape, RapierPose::IDENTITY, &mut parts)?;
    let weighing = match shape {
        Shape::Hull(_) => Weighing::Centred,
        Shape::Compound(compound) if compound.parts().is_empty() => Weighing::Nothing,
        Shape::Compound(_) if shape.is_solid() => {
            let together = total(&parts);
            check(&together)?;
            Weighing::Together(together)
        }
        _ => Weighing::Plain,
    };
    Ok(Solid {
        parts,
        weighing,
        is_sheet: !shape.is_solid(),
    })
}

fn add_parts(
    shape: &Shape,
    at: RapierPose,
    parts: &mut Vec<(RapierPose, SharedShape)>,
) -> Result<(), UnusableShape> {
    let part = match *shape {
        Shape::Ball { radius } => SharedShape::ball(radius),
        Shape::Cuboid { half_extents } => {
            SharedShape::cuboid(half_extents.x, half_extents.y, half_extents.z)
        }
        Shape::Capsule {
            half_height,
            radius,
        } => SharedShape::capsule_y(half_height, radius),
        Shape::Cylinder {
            half_height,
            radius,
        } => SharedShape::cylinder(half_height, radius),
        Shape::Hull(ref hull) => {
            // The search for faces may panic on points that contradict each other by rounding.
            let made = catch_unwind(|| SharedShape::convex_hull(hull.points()));
            let solid = made.ok().flatten().ok_or(UnusableShape)?;
            check(&solid.mass_properties(1.0))?;
            solid
        }
        Shape::Heights(ref heights) => {
            parts.push((at * middle(heights), ground(heights)?));
            return Ok(());
        }
        Shape::Mesh(ref mesh) => triangles(mesh)?,
        Shape::Compound(ref compound) => {
            for part in compound.parts() {
                add_parts(&part.shape, at * pose(part.position, part.rotation), parts)?;
            }
            return Ok(());
        }
    };
    parts.push((at, part));
    Ok(())
}

/// Centre of a height field: the origin of Rapier's coordinates.
fn middle(heights: &Heights) -> RapierPose {
    let half = |count: u32, spacing| (count - 1) as f32 * spacing * 0.5;
    let x = half(heights.rows(), heights.row_spacing());
    let z = half(heights.columns(), heights.column_spacing());
    RapierPose::from_parts(Vec3::new(x, 0.0, z), Quat::IDENTITY)
}

fn ground(heights: &Heights) -> Result<SharedShape, UnusableShape> {
    let (rows, columns) = (heights.rows() as usize, heights.columns() as usize);
    // Rapier's rows go along z, which are the columns here, and it stores column by column: the row-by-row order here
    // fits.
    let posts = heights.heights().to_vec();
    let scale = Vec3::new(
        (rows - 1) as f32 * heights.row_spacing(),
        1.0,
        (columns - 1) as f32 * heights.column_spacing(),
    );
    // Rapier's fix of inner edges stays off: with it, capsules that stand on flat ground fall through (measured).
    let build = || SharedShape::heightfield(Array2::new(columns, rows, posts), scale);
    catch_unwind(build).map_err(|_| UnusableShape)
}

fn triangles(mesh: &Mesh) -> Result<SharedShape, UnusableShape> {
    let (points, triangles) = (mesh.points().to_vec(), mesh.triangles().to_vec());
    let made = catch_unwind(|| SharedShape::trimesh(points, triangles));
    made.ok().and_then(Result::ok).ok_or(UnusableShape)
}

/// Mass properties of all parts together, at density one.
fn total(parts: &[(RapierPose, SharedShape)]) -> MassProperties {
    let properties = parts.iter().map(|(at, part)| {
        let own = part.mass_properties(1.0);
        own.transform_by(at)
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
pub(super) fn colliders(new_body: &NewBody, solid: &Solid) -> impl Iterator<Item = Collider> {
    let material = new_body.material;
    solid.parts.iter().map(move |(at, part)| {
        let builder = ColliderBuilder::new(part.clone())
            .friction(material.friction)
            .restitution(material.restitution);
        let builder = match solid.weighing {
            Weighing::Plain => builder.density(material.density),
            Weighing::Centred => builder.mass_properties(MassProperties {
                local_com: Vec3::ZERO,
                ..part.mass_properties(material.density)
            }),
            Weighing::Together(_) | Weighing::Nothing => builder.density(0.0),
        };
        if *at == RapierPose::IDENTITY {
            builder.build()
        } else {
            builder.position(*at).build()
        }
    })
}

/// Mass of a body in addition to its colliders'.
pub(super) fn mass_beside(new_body: &NewBody, solid: &Solid) -> Option<MassProperties> {
    match solid.weighing {
        Weighing::Plain | Weighing::Centred => None,
        Weighing::Together(unit) => {
            let density = new_body.material.density;
            Some(MassProperties::with_principal_inertia_frame(
                Vec3::ZERO,
                unit.mass() * density,
                unit.principal_inertia() * density,
                unit.principal_inertia_local_frame,
            ))
        }
        // A body without shape falls too: a kilogram with the moments of a ball of one metre.
        Weighing::Nothing => Some(MassProperties::new(Vec3::ZERO, 1.0, Vec3::splat(0.4))),
    }
}

/// Mass properties of a shape with volume; for a mesh, of the enclosed volume.
///
/// # Errors
///
/// [`UnusableShape`] when no solid can be made, or one without mass.
#[cfg(feature = "app")]
pub(crate) fn bulk(shape: &Shape) -> Result<rhumb_app::Bulk, UnusableShape> {
    let mut parts = Vec::new();
    add_parts(shape, RapierPose::IDENTITY, &mut parts)?;
    let properties =
        catch_unwind(std::panic::AssertUnwindSafe(|| total(&parts))).map_err(|_| UnusableShape)?;
    check(&properties)?;
    Ok(rhumb_app::Bulk {
        centre: properties.local_com,
        volume: properties.mass(),
    })
}
