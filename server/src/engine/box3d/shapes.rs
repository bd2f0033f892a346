//! Conversion of shapes to Box3D.
//!
//! Cylinders and cones are hulls with as many sides as [`SIDES`]. Ground and meshes are triangle meshes. Box3D has no
//! half-spaces, and no boxes with round edges.

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};
use rhumb_protocol::scene::{Heights, Shape};
use rhumb_solids::{SolidPart, UnitMass};

use super::native::{HullData, MeshData, NativePiece, Placement, Surface};
use crate::engine::interface::{BodyProperties, UnusableShape};

/// Sides of the hull of a cylinder or a cone.
const SIDES: u16 = 24;

/// Solid that all bodies of one shape share.
pub(super) struct Box3dSolid {
    pub(super) pieces: Vec<NativePiece>,
    /// Mass at density one; `None` for a shape without volume.
    pub(super) unit: Option<UnitMass>,
    /// The same solid for queries.
    pub(super) parts: Vec<SolidPart>,
}

/// True if Box3D has such a shape, and such parts.
pub(super) fn supports(shape: &Shape) -> bool {
    match shape {
        Shape::RoundedCuboid { .. } | Shape::HalfSpace { .. } => false,
        Shape::Compound(compound) => compound.parts().iter().all(|part| supports(&part.shape)),
        _ => true,
    }
}

/// The solid of a shape; bodies share it.
///
/// # Errors
///
/// [`UnusableShape`] for a shape without faces, with a hull of too many points, or without normal mass and moments.
pub(super) fn solid(shape: &Shape) -> Result<Box3dSolid, UnusableShape> {
    let mut pieces = Vec::new();
    add_pieces(shape, (Vec3::ZERO, Quat::IDENTITY), &mut pieces)?;
    let parts = rhumb_solids::parts(shape).ok_or(UnusableShape)?;
    let has_volume = shape.is_solid() && !parts.is_empty();
    let unit = UnitMass::of(&parts).filter(|_| has_volume);
    if has_volume && unit.is_none() {
        return Err(UnusableShape);
    }
    Ok(Box3dSolid {
        pieces,
        unit,
        parts,
    })
}

/// Adds the pieces of a shape at a pose of its body.
fn add_pieces(
    shape: &Shape,
    (centre, turn): Placement,
    pieces: &mut Vec<NativePiece>,
) -> Result<(), UnusableShape> {
    let place = |point: Vec3| centre + turn * point;
    let hull = |points: &mut dyn Iterator<Item = Vec3>| {
        let points: Vec<_> = points.map(place).collect();
        let hull = HullData::new(&points).ok_or(UnusableShape)?;
        Ok(NativePiece::Hull(Arc::new(hull)))
    };
    let piece = match shape {
        Shape::Ball { radius } => NativePiece::Sphere(centre, *radius),
        Shape::Capsule {
            half_height,
            radius,
        } => {
            let end = Vec3::Y * *half_height;
            NativePiece::Capsule([place(-end), place(end)], *radius)
        }
        Shape::Cuboid { half_extents } => NativePiece::Cuboid(*half_extents, (centre, turn)),
        Shape::Cylinder {
            half_height: h,
            radius,
        } => hull(&mut ring(*radius, -h).chain(ring(*radius, *h)))?,
        Shape::Cone {
            half_height: h,
            radius,
        } => {
            let tip = Vec3::new(0.0, h * 1.5, 0.0);
            hull(&mut ring(*radius, -h * 0.5).chain([tip]))?
        }
        Shape::Hull(of) => hull(&mut of.points().iter().copied())?,
        Shape::Heights(heights) => {
            let (points, triangles) = ground(heights);
            mesh(points.into_iter().map(place), &triangles)?
        }
        Shape::Mesh(of) => mesh(of.points().iter().copied().map(place), of.triangles())?,
        Shape::Compound(compound) => {
            for part in compound.parts() {
                let at = (place(part.position), turn * part.rotation);
                add_pieces(&part.shape, at, pieces)?;
            }
            return Ok(());
        }
        Shape::RoundedCuboid { .. } | Shape::HalfSpace { .. } => return Err(UnusableShape),
    };
    pieces.push(piece);
    Ok(())
}

/// Points on a circle around the y axis.
fn ring(radius: f32, height: f32) -> impl Iterator<Item = Vec3> {
    (0..SIDES).map(move |side| {
        let angle = f32::from(side) / f32::from(SIDES) * core::f32::consts::TAU;
        Quat::from_rotation_y(angle) * Vec3::new(radius, height, 0.0)
    })
}

fn mesh(
    points: impl Iterator<Item = Vec3>,
    triangles: &[[u32; 3]],
) -> Result<NativePiece, UnusableShape> {
    let points: Vec<_> = points.collect();
    let mesh = MeshData::new(&points, triangles).ok_or(UnusableShape)?;
    Ok(NativePiece::Mesh(Arc::new(mesh)))
}

/// The posts of a height field and two triangles for each cell, whose fronts are up.
fn ground(heights: &Heights) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let points = heights.posts().map(DVec3::as_vec3).collect();
    let (rows, columns) = (heights.rows(), heights.columns());
    let mut triangles = Vec::new();
    for row in 0..rows - 1 {
        for column in 0..columns - 1 {
            let near = row * columns + column;
            let far = near + columns;
            triangles.push([near, near + 1, far]);
            triangles.push([far, near + 1, far + 1]);
        }
    }
    (points, triangles)
}

/// The surface and the filter of a body's shapes.
pub(super) const fn surface(properties: &BodyProperties) -> Surface {
    let (desc, material) = (&properties.desc, properties.material);
    Surface {
        friction: material.friction,
        restitution: material.restitution,
        members: desc.groups.members,
        touches: desc.groups.touches,
        is_sensor: desc.sensor,
    }
}
