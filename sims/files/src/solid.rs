//! Solids of files as shapes of the protocol, and their mass.
//!
//! Long axes of files lie along z, those of the protocol along y. A solid without a shape of its own becomes a hull, and the
//! report says how far off it is.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::limits::{EXTENT_MAX, EXTENT_MIN, TRIANGLES_MAX};
use rhumb_protocol::scene::{Invalid, Mesh, Shape};

use crate::inertia::{Inertia, Pose};
use crate::mesh::{TriangleMesh, directions, hull};
use crate::model::Solid;
use crate::report::{Effect, Place, Report};

/// A shape and its pose in the axes of its body.
pub(crate) struct Placement {
    pub(crate) pose: Pose,
    pub(crate) shape: Shape,
}

/// The solid of a body, and where notes about it belong.
pub(crate) struct Subject<'a> {
    pub(crate) place: &'a Place,
    pub(crate) name: &'a str,
    /// True if no engine moves the body.
    pub(crate) fixed: bool,
}

/// Points of an ellipsoid's hull.
const ELLIPSOID_POINTS: u32 = 200;

impl Solid {
    /// Mass at a density, in its own axes; `None` for one without an inside.
    pub(crate) fn inertia(&self, density: f64) -> Option<Inertia> {
        let box_like = |mass: f64, half: DVec3, share: f64| {
            let squared = half * half;
            let sums = DVec3::splat(squared.element_sum()) - squared;
            Inertia::diagonal(mass, sums * (mass * share))
        };
        Some(match *self {
            Self::Ball { radius } => {
                let half = DVec3::splat(radius);
                box_like(ellipsoid(half) * density, half, 0.2)
            }
            Self::Ellipsoid { half } => box_like(ellipsoid(half) * density, half, 0.2),
            Self::Cuboid { half } => {
                box_like(8.0 * half.element_product() * density, half, 1.0 / 3.0)
            }
            Self::Cylinder { half, radius } => cylinder(density, half, radius),
            Self::Capsule { half, radius } => {
                // Two half balls; each one's centre is 3/8 of the radius from its base.
                let own = ellipsoid(DVec3::splat(radius)) * density * 0.5;
                let squared = radius * radius;
                let across = own * (squared * 0.4 - (0.375 * radius) * (0.375 * radius));
                let cap = Inertia::diagonal(own, DVec3::new(across, across, own * squared * 0.4));
                let at = |z: f64| cap.moved(&Pose::at(DVec3::new(0.0, 0.0, z)));
                let end = half + 0.375 * radius;
                cylinder(density, half, radius)
                    .plus(&at(end))
                    .plus(&at(-end))
            }
            Self::Hull(ref mesh) | Self::Mesh(ref mesh) => return mesh.inertia(density),
            Self::Plane => return None,
        })
    }

    /// The shape of it; `None` for one that its body cannot have, with a note.
    pub(crate) fn shape(
        &self,
        pose: &Pose,
        subject: &Subject<'_>,
        report: &mut Report,
    ) -> Option<Result<Placement, Invalid>> {
        let along_z = || Pose::new(DVec3::ZERO, DQuat::from_rotation_x(FRAC_PI_2));
        let mut clamp = |extents: DVec3| clamped(extents, subject, report);
        let placed = |pose: Pose, shape| Some(Ok(Placement { pose, shape }));
        match *self {
            Self::Ball { radius } => {
                let radius = clamp(DVec3::splat(radius)).x;
                placed(*pose, Shape::ball(radius))
            }
            Self::Cuboid { half } => {
                let half_extents = clamp(half);
                placed(*pose, Shape::Cuboid { half_extents })
            }
            Self::Cylinder { half, radius } => {
                let sizes = clamp(DVec3::new(radius, radius, half));
                placed(pose.of(&along_z()), Shape::cylinder(sizes.z, sizes.x))
            }
            Self::Capsule { half, radius } => {
                let sizes = clamp(DVec3::new(radius, radius, half));
                placed(pose.of(&along_z()), Shape::capsule(sizes.z, sizes.x))
            }
            Self::Ellipsoid { half } => Some(ellipsoid_shape(half, pose, subject, report)),
            Self::Plane if !subject.fixed => {
                let why = "planes are for bodies that nothing moves";
                let name = subject.name.to_owned();
                report.add(subject.place, name, String::new(), Effect::Left, why);
                None
            }
            Self::Plane => {
                let normal = Vec3::Z;
                placed(*pose, Shape::HalfSpace { normal })
            }
            Self::Mesh(ref mesh) if subject.fixed && mesh.triangles.len() <= TRIANGLES_MAX => {
                let points: Vec<_> = mesh.points.iter().map(|at| at.as_vec3()).collect();
                match Mesh::new(&points, &mesh.triangles) {
                    Ok(mesh) => placed(*pose, Shape::Mesh(mesh)),
                    Err(_) => Some(hull_shape(mesh, pose, subject, report)),
                }
            }
            Self::Hull(ref mesh) | Self::Mesh(ref mesh) => {
                Some(hull_shape(mesh, pose, subject, report))
            }
        }
    }
}

/// Volume of an ellipsoid, m³.
fn ellipsoid(half: DVec3) -> f64 {
    4.0 / 3.0 * PI * half.element_product()
}

fn cylinder(density: f64, half: f64, radius: f64) -> Inertia {
    let mass = 2.0 * half * PI * radius * radius * density;
    let along = mass * radius * radius * 0.5;
    let across = mass * (radius * radius / 4.0 + half * half / 3.0);
    Inertia::diagonal(mass, DVec3::new(across, across, along))
}

/// Extents within the limits of shapes, with a note where they were not.
fn clamped(extents: DVec3, subject: &Subject<'_>, report: &mut Report) -> Vec3 {
    let (least, most) = (f64::from(EXTENT_MIN), f64::from(EXTENT_MAX));
    let within = extents.clamp(DVec3::splat(least), DVec3::splat(most));
    if within != extents {
        let value = format!("{extents} m, now {within} m");
        let why = "extents of shapes are 0.001 m to 10,000 m";
        report.add(
            subject.place,
            subject.name.to_owned(),
            value,
            Effect::Changed,
            why,
        );
    }
    within
        .as_vec3()
        .max(Vec3::splat(EXTENT_MIN))
        .min(Vec3::splat(EXTENT_MAX))
}

fn ellipsoid_shape(
    half: DVec3,
    pose: &Pose,
    subject: &Subject<'_>,
    report: &mut Report,
) -> Result<Placement, Invalid> {
    let half = clamped(half, subject, report);
    let points: Vec<_> = directions(ELLIPSOID_POINTS).map(|at| at * half).collect();
    let (hull, _) = hull(&points)?;
    let value = format!("half axes {half} m");
    let why = "an ellipsoid is a hull of 200 corners on it, up to 2 % of a half axis inside";
    report.add(
        subject.place,
        subject.name.to_owned(),
        value,
        Effect::Approximated,
        why,
    );
    let (pose, shape) = (*pose, Shape::Hull(hull));
    Ok(Placement { pose, shape })
}

/// Thickness of a mesh, as a share of its length, below which engines make no solid of its hull.
const FLAT: f64 = 0.005;

/// The hull of a mesh, in the axes of the body; a flat mesh becomes a thin box.
fn hull_shape(
    mesh: &TriangleMesh,
    pose: &Pose,
    subject: &Subject<'_>,
    report: &mut Report,
) -> Result<Placement, Invalid> {
    let (least, most) = mesh.bounds();
    let middle = (least + most) * 0.5;
    let points: Vec<_> = mesh
        .points
        .iter()
        .map(|at| (*at - middle).as_vec3())
        .collect();
    let pose = pose.of(&Pose::at(middle));
    let mut note = |value, why| {
        let name = subject.name.to_owned();
        report.add(subject.place, name, value, Effect::Approximated, why);
    };
    let half = (most - least) * 0.5;
    let is_flat = half.min_element() < half.max_element() * FLAT;
    match hull(&points) {
        Ok((hull, lost)) if !is_flat => {
            if lost > 0.0 {
                let value = format!("{} corners, up to {lost:.4} m inside", hull.points().len());
                note(value, "a hull has at most 255 corners");
            }
            let shape = Shape::Hull(hull);
            Ok(Placement { pose, shape })
        }
        read => {
            if half.max_element() < f64::from(EXTENT_MIN) * 0.01 {
                read?;
            }
            note(
                format!("{half} m"),
                "a mesh that is too flat for a hull is the box around it",
            );
            let half_extents = clamped(half, subject, report);
            let shape = Shape::Cuboid { half_extents };
            Ok(Placement { pose, shape })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_capsule_weighs_as_its_parts() {
        let capsule = Solid::Capsule {
            half: 0.5,
            radius: 0.1,
        };
        let inertia = capsule.inertia(1_000.0).expect("it is a solid");
        // By hand: a cylinder of 31.416 kg, two half balls of 2.094 kg at 0.5375 m.
        assert!(
            (inertia.mass - 35.604_716_74).abs() < 1e-6,
            "{}",
            inertia.mass
        );
        let (moments, _) = inertia.principal();
        assert!((moments.z - 0.173_834_793).abs() < 1e-6, "{moments}");
        assert!((moments.x - 3.917_5).abs() < 1e-3, "{moments}");
    }
}
