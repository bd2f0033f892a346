//! Rocks: irregular convex hulls around their centre of mass.
//!
//! Jittered points of a uniform spiral on a sphere are scaled along three axes and tapered by a projection that keeps
//! all of them corners. Volume and centre are computed in f64, so the bits are equal on every platform.

use glam::{DVec3, Vec3};

use crate::rng::SceneRng;

/// A rock of scale one.
#[derive(Clone, Debug)]
pub(crate) struct Rock {
    /// Corners relative to the centre of mass, metres.
    pub(crate) points: Vec<Vec3>,
    /// Volume, m³.
    pub(crate) volume: f64,
    /// Distance of the farthest corner, metres.
    pub(crate) radius: f64,
}

impl Rock {
    /// A rock with `corners` corners and these extents along x, y and z, metres.
    pub(crate) fn new(corners: u32, extents: DVec3, rng: &mut SceneRng) -> Self {
        let mut points: Vec<_> = directions(corners, rng)
            .map(|direction| direction / (1.0 + TAPER * direction.dot(DVec3::new(0.6, 0.0, 0.8))))
            .collect();
        let least = points.iter().copied().fold(points[0], DVec3::min);
        let most = points.iter().copied().fold(points[0], DVec3::max);
        for point in &mut points {
            *point = (*point - (least + most) * 0.5) * extents / (most - least);
        }
        let (volume, centre) = solid(&points);
        let points: Vec<_> = points
            .iter()
            .map(|point| (*point - centre).as_vec3())
            .collect();
        let squared = points.iter().map(|point| point.as_dvec3().length_squared());
        let radius = libm::sqrt(squared.fold(0.0, f64::max));
        Self {
            points,
            volume,
            radius,
        }
    }
}

/// Difference in size between the two ends.
const TAPER: f64 = 0.2;
/// Largest jitter of a direction, as a share of the spacing.
const SHAKE: f64 = 0.25;

/// Unit vectors on a spiral of equal areas, with jitter.
fn directions(count: u32, rng: &mut SceneRng) -> impl Iterator<Item = DVec3> {
    let golden = core::f64::consts::PI * (3.0 - libm::sqrt(5.0));
    let apart = libm::sqrt(4.0 * core::f64::consts::PI / f64::from(count));
    (0..count).map(move |place| {
        let height = 1.0 - (2.0 * f64::from(place) + 1.0) / f64::from(count);
        let around = libm::sqrt(1.0 - height * height);
        let angle = golden * f64::from(place);
        let even = DVec3::new(around * libm::cos(angle), height, around * libm::sin(angle));
        let shaken = even + rng.vector().as_dvec3() * (SHAKE * apart);
        shaken / libm::sqrt(shaken.length_squared())
    })
}

/// Volume and centre of mass of the hull of points of which no four are coplanar.
///
/// A triangle with all other points on one side is a face; the tetrahedra from the origin to the faces make up the
/// solid. Cost is about cubic in the number of points, because most triangles are rejected early.
fn solid(points: &[DVec3]) -> (f64, DVec3) {
    let (mut volume, mut moment) = (0.0, DVec3::ZERO);
    for (i, a) in points.iter().enumerate() {
        for (j, b) in points.iter().enumerate().skip(i + 1) {
            for (k, c) in points.iter().enumerate().skip(j + 1) {
                let normal = (*b - *a).cross(*c - *a);
                let sides = || {
                    let others = points.iter().enumerate();
                    let others = others.filter(|(place, _)| ![i, j, k].contains(place));
                    others.map(|(_, other)| normal.dot(*other - *a) > 0.0)
                };
                let above = sides().next().unwrap_or(false);
                if sides().all(|side| side == above) {
                    let sixth = normal.dot(*a) * if above { -1.0 } else { 1.0 } / 6.0;
                    volume += sixth;
                    moment += (*a + *b + *c) * (sixth * 0.25);
                }
            }
        }
    }
    (volume, moment / volume)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tetrahedron_has_a_sixth_of_the_volume_and_its_centre_at_the_mean_corner() {
        let shift = DVec3::new(3.0, -2.0, 5.0);
        let points = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|point| point + shift);
        let (volume, centre) = solid(&points);
        assert!((volume - 1.0 / 6.0).abs() < 1e-12);
        assert!((centre - shift - DVec3::splat(0.25)).length() < 1e-12);
    }

    #[test]
    fn a_rock_of_many_corners_has_nearly_the_volume_of_its_ellipsoid() {
        let extents = DVec3::new(3.0, 2.0, 2.5);
        let rock = Rock::new(116, extents, &mut SceneRng::new(5));
        let ellipsoid = core::f64::consts::PI / 6.0 * extents.element_product();
        assert_eq!(rock.points.len(), 116);
        assert!(
            rock.volume > 0.85 * ellipsoid && rock.volume < ellipsoid,
            "{}",
            rock.volume
        );
        assert!(rock.radius > 1.4 && rock.radius < 1.75, "{}", rock.radius);
    }
}
