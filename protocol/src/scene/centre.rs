//! Centre of mass of a shape, and shapes moved to it.
//!
//! A body's pose is that of its centre of mass, and a shape is given from there. Programs that have a shape from elsewhere
//! find its centre here. Masses add up as in an engine: where parts overlap, both count.

use core::f64::consts::PI;

use alloc::vec::Vec;

use glam::{DVec3, Vec3};

use super::convex::Convex;
use super::hull::Hull;
use super::shape::{Compound, Part, Shape};

/// Least distance of a centre from the origin that counts, as a share of the bounding radius. Rounding makes less.
const OFF_CENTRE: f64 = 1e-4;

impl Shape {
    /// The centre of mass of the shape at an even density, metres in the body's axes, if it is not the origin.
    ///
    /// The server takes the origin of a shape for its centre of mass. `None` for a shape whose centre is its origin, but for
    /// rounding, and for one without an inside. Hulls and compounds alone can have another.
    #[must_use]
    pub fn centre(&self) -> Option<Vec3> {
        let (_, centre) = weight(self)?;
        let radius = self.bounding_radius().metres();
        let is_off = libm::sqrt(centre.length_squared()) > OFF_CENTRE * radius;
        is_off.then(|| centre.as_vec3())
    }

    /// The shape moved so that its centre of mass is the origin, and where the centre was: metres in the body's axes.
    ///
    /// A body of the moved shape lies as this one would if its pose is moved by the centre, turned as the body is. A shape
    /// without another centre is returned as it is, with zero.
    #[must_use]
    pub fn centred(&self) -> (Self, Vec3) {
        let moved = self.centre().and_then(|centre| {
            let moved = match self {
                Self::Hull(hull) => {
                    let points: Vec<_> = hull.points().iter().map(|at| *at - centre).collect();
                    Self::Hull(Hull::new(&points).ok()?)
                }
                Self::Compound(compound) => {
                    let parts = compound.parts().iter().map(|part| Part {
                        position: part.position - centre,
                        ..part.clone()
                    });
                    Self::Compound(Compound::new(parts.collect()).ok()?)
                }
                _ => return None,
            };
            Some((moved, centre))
        });
        moved.unwrap_or_else(|| (self.clone(), Vec3::ZERO))
    }
}

/// Volume and centre of a solid; `None` for one without an inside.
fn weight(shape: &Shape) -> Option<(f64, DVec3)> {
    let cylinder = |half_height: f32, radius: f32| {
        let radius = f64::from(radius);
        2.0 * f64::from(half_height) * PI * radius * radius
    };
    let ball = |radius: f32| {
        let radius = f64::from(radius);
        4.0 / 3.0 * PI * radius * radius * radius
    };
    let volume = match *shape {
        Shape::Ball { radius } => ball(radius),
        // The engine weighs a rounded box as the box inside.
        Shape::Cuboid { half_extents } | Shape::RoundedCuboid { half_extents, .. } => {
            8.0 * half_extents.as_dvec3().element_product()
        }
        Shape::Capsule {
            half_height,
            radius,
        } => cylinder(half_height, radius) + ball(radius),
        Shape::Cylinder {
            half_height,
            radius,
        } => cylinder(half_height, radius),
        Shape::Cone {
            half_height,
            radius,
        } => cylinder(half_height, radius) / 3.0,
        Shape::Hull(ref hull) => {
            let (volume, centre) = Convex::of(hull.points())?.volume();
            return (volume > 0.0 && centre.is_finite()).then_some((volume, centre));
        }
        Shape::Compound(ref compound) => {
            let (mut volume, mut moment) = (0.0, DVec3::ZERO);
            for part in compound.parts() {
                let (own, centre) = weight(&part.shape)?;
                let rotation = part.rotation.as_dquat().normalize();
                volume += own;
                moment += (part.position.as_dvec3() + rotation * centre) * own;
            }
            return (volume > 0.0).then(|| (volume, moment / volume));
        }
        Shape::Heights(_) | Shape::Mesh(_) | Shape::HalfSpace { .. } => return None,
    };
    Some((volume, DVec3::ZERO))
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use glam::Quat;

    use super::*;

    fn hull(points: &[[f32; 3]]) -> Shape {
        let points: Vec<_> = points.iter().map(|at| Vec3::from_array(*at)).collect();
        Shape::Hull(Hull::new(&points).expect("a solid"))
    }

    fn wedge() -> Shape {
        let ends = [0.0, 3.0];
        let corners = ends.map(|z| [[0.0, 0.0, z], [2.0, 0.0, z], [0.0, 1.0, z]]);
        hull(&corners.concat())
    }

    #[test]
    fn the_centre_of_a_wedge_and_of_a_pyramid_is_that_of_their_volume() {
        let centre = wedge().centre().expect("it is off the origin");
        assert!((centre - Vec3::new(2.0 / 3.0, 1.0 / 3.0, 1.5)).length() < 1e-6);
        let pyramid = hull(&[
            [-1.0, 0.0, -1.0],
            [1.0, 0.0, -1.0],
            [1.0, 0.0, 1.0],
            [-1.0, 0.0, 1.0],
            [0.0, 4.0, 0.0],
        ]);
        let centre = pyramid.centre().expect("it is off the origin");
        assert!((centre - Vec3::Y).length() < 1e-6);
    }

    #[test]
    fn the_centre_of_a_compound_weighs_its_parts_by_volume() {
        let part = |x: f32, shape: Shape| Part {
            position: Vec3::new(x, 0.0, 0.0),
            rotation: Quat::from_rotation_z(core::f32::consts::FRAC_PI_2),
            shape,
        };
        let angle = Compound::new(vec![
            part(0.0, Shape::cuboid(0.5, 0.5, 0.5)),
            part(4.0, Shape::cuboid(0.5, 1.5, 0.5)),
        ]);
        let shape = Shape::Compound(angle.expect("two boxes"));
        let centre = shape.centre().expect("it is off the origin");
        assert!((centre - Vec3::X * 3.0).length() < 1e-6, "{centre}");
        // The wedge's centre, turned by a quarter about z, and three metres of x.
        let turned = Compound::new(vec![part(3.0, wedge())]).expect("a wedge");
        let centre = Shape::Compound(turned)
            .centre()
            .expect("it is off the origin");
        assert!((centre - Vec3::new(3.0 - 1.0 / 3.0, 2.0 / 3.0, 1.5)).length() < 1e-6);
    }

    #[test]
    fn a_centred_shape_has_its_centre_at_the_origin_and_stays_as_it_is() {
        let (moved, centre) = wedge().centred();
        assert_eq!(moved.centre(), None);
        assert_eq!(moved.centred(), (moved.clone(), Vec3::ZERO));
        let (Shape::Hull(before), Shape::Hull(after)) = (wedge(), moved) else {
            panic!("both are hulls");
        };
        for (before, after) in before.points().iter().zip(after.points()) {
            assert!((*before - centre - *after).length() < 1e-6);
        }
        for shape in [
            Shape::ball(0.5),
            Shape::cone(1.0, 0.5),
            Shape::Compound(Compound::nothing()),
        ] {
            assert_eq!(shape.centred(), (shape.clone(), Vec3::ZERO));
        }
    }
}
