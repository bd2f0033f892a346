//! Convex hull of a few points, as a shape.
//!
//! Faces are not known here: engines find them. One pass over the points checks them; only the engine can tell whether
//! a solid can be made of them. Cheap to copy: copies share their points.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, Rule, count, outside, scalar};
use super::convex::Convex;
use crate::limits::{EXTENT_MAX, EXTENT_MIN, HULL_FLATNESS, HULL_POINTS_MAX, HULL_POINTS_MIN};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The convex hull of points in the body's axes, metres, from the centre of mass.
#[derive(Clone, Debug)]
pub struct Hull {
    points: Arc<[Vec3]>,
    /// Distance of the farthest point, metres.
    radius: f64,
}

impl Hull {
    /// The hull of some points, given from the body's centre of mass: see [`Shape::centred`] for points that are not.
    ///
    /// Of more points than [`HULL_POINTS_MAX`] those inside the hull, or on it between others, are left out.
    ///
    /// [`Shape::centred`]: super::Shape::centred
    ///
    /// # Errors
    ///
    /// [`Invalid`] when there are too few or too many, when a coordinate is not finite or beyond the limits, or when
    /// the points lie almost in a plane.
    pub fn new(points: &[Vec3]) -> Result<Self, Invalid> {
        let (least, most) = (HULL_POINTS_MIN, HULL_POINTS_MAX);
        let corners = (points.len() > most).then(|| corners(points));
        let name = corners.as_ref().map(|_| "number of a hull's corners");
        let points = corners.as_deref().unwrap_or(points);
        count(points.len(), least, most, Quantity::HullPoints)
            .map_err(|wrong| name.map_or(wrong, |name| wrong.of(name, "")))
            .map_err(|wrong| wrong.advised(MANY_CORNERS))?;
        let hull = Self::unchecked(points.to_vec());
        hull.check()?;
        Ok(hull)
    }

    fn unchecked(points: Vec<Vec3>) -> Self {
        let squared = points.iter().map(|point| point.as_dvec3().length_squared());
        let radius = libm::sqrt(squared.fold(0.0, f64::max));
        Self {
            points: points.into(),
            radius,
        }
    }

    /// The points, in the order in which they were given.
    #[must_use]
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// Radius of the least ball around the centre of mass that holds the hull.
    #[must_use]
    pub fn bounding_radius(&self) -> Metres {
        Metres::new(self.radius)
    }

    /// Half extents of the least box along the body's axes, around the centre of mass, that holds the hull.
    #[must_use]
    pub fn half_extents(&self) -> Vec3 {
        let sizes = self.points.iter().map(|point| point.abs());
        sizes.fold(Vec3::ZERO, Vec3::max)
    }

    /// Checks every coordinate, and that the hull has volume (PROTOCOL 2.6).
    pub(super) fn check(&self) -> Result<(), Invalid> {
        for point in self.points.iter() {
            for part in point.to_array() {
                scalar(part, -EXTENT_MAX, EXTENT_MAX, Quantity::Extent)
                    .map_err(|wrong| wrong.of("coordinate of a hull's point", "m"))?;
            }
        }
        let least = f64::from(EXTENT_MIN).max(self.radius * f64::from(HULL_FLATNESS));
        let thickness = self.thickness();
        if thickness < least {
            let numbers = [thickness, least, 2.0 * f64::from(EXTENT_MAX)];
            return Err(outside(Rule::OutOfRange, Quantity::HullThickness, numbers));
        }
        Ok(())
    }

    /// The distance of the farthest point from a plane, metres. The plane goes through the first point, the point
    /// farthest from that, and the point farthest from the line through both. Zero where these do not make a plane.
    fn thickness(&self) -> f64 {
        let points = || self.points.iter().map(|point| point.as_dvec3());
        let farthest = |measure: &dyn Fn(DVec3) -> f64| {
            let mut best = (0.0, DVec3::ZERO);
            for point in points() {
                let measured = measure(point);
                if measured > best.0 {
                    best = (measured, point);
                }
            }
            best
        };
        let Some(first) = points().next() else {
            return 0.0;
        };
        let (_, second) = farthest(&|point| (point - first).length_squared());
        let along = second - first;
        let (_, third) = farthest(&|point| along.cross(point - first).length_squared());
        let normal = along.cross(third - first);
        let length = libm::sqrt(normal.length_squared());
        let (volume, _) = farthest(&|point| normal.dot(point - first).abs());
        if length > 0.0 { volume / length } else { 0.0 }
    }
}

/// What helps against too many corners.
const MANY_CORNERS: &str = "leave out corners that are close to others, make a compound of several \
    hulls, or take a mesh for a body that no engine moves";

/// The corners among these points; all points if they have no volume.
fn corners(points: &[Vec3]) -> Vec<Vec3> {
    let corners = Convex::of(points).map(|convex| convex.corners());
    let corners = corners.map(|places| places.into_iter().map(|place| points[place]).collect());
    corners.unwrap_or_else(|| points.to_vec())
}

/// Two hulls are equal when their points are, in the same order.
impl PartialEq for Hull {
    fn eq(&self, other: &Self) -> bool {
        // Copies share their points, and need no look at them.
        Arc::ptr_eq(&self.points, &other.points) || self.points == other.points
    }
}

impl Wire for Hull {
    fn encode(&self, to: &mut Writer) {
        debug_assert!(self.points.len() <= HULL_POINTS_MAX, "counted when made");
        to.u8(self.points.len() as u8);
        for point in self.points.iter() {
            to.f32s(&point.to_array());
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let count = usize::from(from.u8()?);
        if count < HULL_POINTS_MIN {
            return Err(Malformed::OutOfRange);
        }
        let mut points = Vec::with_capacity(count);
        for _ in 0..count {
            points.push(Vec3::from_array(from.f32s()?));
        }
        Ok(Self::unchecked(points))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [Vec3; 4] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];

    fn refused(points: &[Vec3]) -> Invalid {
        Hull::new(points).expect_err("the test makes it wrong")
    }

    #[test]
    fn a_hull_without_volume_is_refused_as_too_thin() {
        let thin = Invalid::out_of_range(Quantity::HullThickness);
        assert_eq!(refused(&[Vec3::ONE; 4]), thin);
        assert_eq!(refused(&[0.0, 1.0, 2.0, 3.0].map(Vec3::splat)), thin);
        assert_eq!(
            refused(&[Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE - Vec3::Z]),
            thin
        );
        assert_eq!(refused(&CORNERS.map(|point| point * 1e-3 * 0.5)), thin);
        // A sheet of a kilometre, half a metre thick.
        let sheet = CORNERS.map(|point| point * Vec3::new(1e3, 1e3, 0.5));
        assert_eq!(refused(&sheet), thin);
        assert!(Hull::new(&CORNERS.map(|point| point * 1e-2)).is_ok());
        assert!(Hull::new(&CORNERS.map(|point| point * 1e4)).is_ok());
    }

    #[test]
    fn an_invalid_hull_error_names_the_fault() {
        for (wrong, invalid) in [
            (f32::NAN, Invalid::not_finite(Quantity::Extent)),
            (f32::INFINITY, Invalid::not_finite(Quantity::Extent)),
            (2e4, Invalid::out_of_range(Quantity::Extent)),
            (-f32::MAX, Invalid::out_of_range(Quantity::Extent)),
        ] {
            let mut points = CORNERS;
            points[2].y = wrong;
            assert_eq!(refused(&points), invalid);
        }
        let many = Invalid::out_of_range(Quantity::HullPoints);
        assert_eq!(refused(&CORNERS[..3]), many);
        assert_eq!(refused(&[Vec3::X; 256]), many);
    }

    #[test]
    fn a_hull_round_trips_and_truncations_are_refused() {
        let hull = Hull::new(&CORNERS).expect("a tetrahedron");
        let mut writer = Writer::new();
        hull.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes.len(), 1 + 4 * 12);
        assert_eq!(Hull::decode(&mut Reader::new(&bytes)), Ok(hull));
        for cut in 0..bytes.len() {
            let cut = Hull::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
        let three = Hull::decode(&mut Reader::new(&[3; 64]));
        assert_eq!(three, Err(Malformed::OutOfRange));
    }

    #[test]
    fn the_bounding_ball_reaches_the_farthest_point() {
        let hull = Hull::new(&[Vec3::X, Vec3::Y, Vec3::Z, Vec3::splat(-2.0)]);
        let radius = hull.expect("a tetrahedron").bounding_radius().metres();
        assert_eq!(radius, libm::sqrt(12.0));
    }
}
