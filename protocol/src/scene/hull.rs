//! Convex hull of points: the shape, its corners, volume and centre.
//!
//! Faces are not known here: engines find them. One pass over the points checks them; only the engine can tell whether
//! a solid can be made of them. Cheap to copy: copies share their points. Corners are found by adding the farthest
//! point to a solid until none is outside. Points that lie within rounding of a face count as inside.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, Rule, count, outside, scalar};
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

/// The advice where a hull has too many corners.
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

/// A face: three corners, counterclockwise from outside.
struct Face {
    corners: [usize; 3],
    normal: DVec3,
    offset: f64,
    /// Points outside of it, each with one face.
    outside: Vec<usize>,
}

/// The convex hull of some points.
pub(super) struct Convex {
    points: Vec<DVec3>,
    faces: Vec<Face>,
    rounding: f64,
    #[cfg(test)]
    is_complete: bool,
}

/// Corners that a hull has at most before the search ends: far more than a shape may have.
const CORNERS_MAX: usize = 4_096;

/// Rounding of a point, as a share of the farthest coordinate: a few units in the last place of f32.
const ROUNDING: f64 = 4e-7;

impl Convex {
    /// The hull of these points; `None` for points that are not finite, or within rounding of a plane.
    pub(super) fn of(points: &[Vec3]) -> Option<Self> {
        let farthest = points.iter().map(|point| point.abs().max_element());
        let farthest = farthest.fold(0.0, f32::max);
        let is_finite = points.iter().all(|point| point.is_finite());
        let mut convex = Self {
            points: points.iter().map(|point| point.as_dvec3()).collect(),
            faces: Vec::new(),
            rounding: f64::from(farthest) * ROUNDING,
            #[cfg(test)]
            is_complete: true,
        };
        let first = convex.tetrahedron().filter(|_| is_finite)?;
        convex.begin(first);
        let mut corners = first.len();
        while let Some(point) = convex.farthest_outside() {
            if corners == CORNERS_MAX {
                #[cfg(test)]
                {
                    convex.is_complete = false;
                }
                break;
            }
            convex.add(point);
            corners += 1;
        }
        Some(convex)
    }

    /// The places of the corners among the points, ascending.
    fn corners(&self) -> Vec<usize> {
        let mut is_corner = vec![false; self.points.len()];
        for face in &self.faces {
            for corner in face.corners {
                is_corner[corner] = true;
            }
        }
        (0..is_corner.len())
            .filter(|point| is_corner[*point])
            .collect()
    }

    /// False if the search ended before it had all corners.
    #[cfg(test)]
    const fn is_complete(&self) -> bool {
        self.is_complete
    }

    /// Volume in cubic metres, and its centre.
    pub(super) fn volume(&self) -> (f64, DVec3) {
        let inside = self
            .faces
            .first()
            .map_or(DVec3::ZERO, |face| self.points[face.corners[0]]);
        let (mut volume, mut moment) = (0.0, DVec3::ZERO);
        for face in &self.faces {
            let [a, b, c] = face.corners.map(|corner| self.points[corner] - inside);
            let part = a.dot(b.cross(c)) / 6.0;
            volume += part;
            moment += (a + b + c) * (part / 4.0);
        }
        (volume, inside + moment / volume)
    }

    /// Four points that span as much as possible.
    fn tetrahedron(&self) -> Option<[usize; 4]> {
        let farthest = |measure: &dyn Fn(DVec3) -> f64| {
            let mut best = (self.rounding, None);
            for (place, point) in self.points.iter().enumerate() {
                let measured = measure(*point);
                if measured > best.0 {
                    best = (measured, Some(place));
                }
            }
            best.1
        };
        let length = |vector: DVec3| libm::sqrt(vector.length_squared());
        let at = |place: usize| self.points[place];
        let start = *self.points.first()?;
        let a = farthest(&|point| length(point - start))?;
        let b = farthest(&|point| length(point - at(a)))?;
        let along = (at(b) - at(a)) / length(at(b) - at(a));
        let c = farthest(&|point| length(along.cross(point - at(a))))?;
        let across = along.cross(at(c) - at(a));
        let normal = across / length(across);
        let d = farthest(&|point| normal.dot(point - at(a)).abs())?;
        // The fourth point lies behind the face of the first three.
        let is_behind = normal.dot(at(d) - at(a)) < 0.0;
        Some(if is_behind {
            [a, b, c, d]
        } else {
            [a, c, b, d]
        })
    }

    fn begin(&mut self, [a, b, c, d]: [usize; 4]) {
        self.faces = [[a, b, c], [a, d, b], [b, d, c], [c, d, a]]
            .map(|corners| self.face(corners))
            .into();
        let all = (0..self.points.len()).collect();
        self.share(all, 0);
    }

    fn face(&self, corners: [usize; 3]) -> Face {
        let [a, b, c] = corners.map(|corner| self.points[corner]);
        let normal = (b - a).cross(c - a);
        let length = libm::sqrt(normal.length_squared());
        let normal = if length > 0.0 {
            normal / length
        } else {
            DVec3::ZERO
        };
        Face {
            corners,
            normal,
            offset: normal.dot(a),
            outside: Vec::new(),
        }
    }

    fn height(&self, face: &Face, point: usize) -> f64 {
        face.normal.dot(self.points[point]) - face.offset
    }

    /// Gives points to faces from this one on that they are outside of.
    fn share(&mut self, points: Vec<usize>, first: usize) {
        for point in points {
            let outside = |face: &Face| self.height(face, point) > self.rounding;
            let face = self.faces[first..].iter().position(outside);
            if let Some(face) = face {
                self.faces[first + face].outside.push(point);
            }
        }
    }

    /// The point that is farthest outside of its face.
    fn farthest_outside(&self) -> Option<usize> {
        let face = self.faces.iter().find(|face| !face.outside.is_empty())?;
        let by_height = |a: &usize, b: &usize| {
            let heights = [a, b].map(|point| self.height(face, *point));
            heights[0].total_cmp(&heights[1])
        };
        face.outside.iter().copied().max_by(by_height)
    }

    /// Replaces the faces that see a point by faces to it.
    fn add(&mut self, point: usize) {
        let faces = core::mem::take(&mut self.faces);
        // Almost exact, as f64 is for points of f32: a face that is kept below a point makes a dent.
        let sees = |face: &Face| self.height(face, point) > self.rounding * 1e-6;
        let (seen, mut kept): (Vec<_>, Vec<_>) = faces.into_iter().partition(sees);
        let (mut edges, mut loose) = (Vec::new(), vec![]);
        for face in seen {
            let [a, b, c] = face.corners;
            edges.extend([[a, b], [b, c], [c, a]]);
            loose.extend(face.outside.into_iter().filter(|other| *other != point));
        }
        let number = |from: usize, to: usize| (from as u64) << 32 | to as u64;
        let mut turned: Vec<u64> = edges.iter().map(|[a, b]| number(*b, *a)).collect();
        turned.sort_unstable();
        // An edge of one face alone is on the border of what the point sees.
        edges.retain(|[a, b]| turned.binary_search(&number(*a, *b)).is_err());
        let first = kept.len();
        kept.extend(edges.iter().map(|[a, b]| self.face([*a, *b, point])));
        self.faces = kept;
        self.share(loose, first);
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

    /// Pseudo-random numbers from −1 to 1.
    fn numbers(mut state: u64) -> impl FnMut() -> f32 {
        move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0
        }
    }

    fn cube(size: f32, corner: Vec3) -> Vec<Vec3> {
        let bit = |place: usize, axis: usize| (place >> axis & 1) as f32;
        let at = |place| Vec3::new(bit(place, 0), bit(place, 1), bit(place, 2));
        (0..8).map(|place| corner + at(place) * size).collect()
    }

    #[test]
    fn the_corners_of_a_cube_are_found_among_points_inside_and_on_it() {
        for seed in 1..20 {
            let mut number = numbers(seed);
            let corner = Vec3::new(number(), number(), number()) * 5.0;
            let mut points = Vec::new();
            for place in 0..3_000 {
                let mut inside = Vec3::new(number(), number(), number()) * 0.5 + 0.5;
                if place % 3 == 0 {
                    inside[place % 9 / 3] = (place % 2) as f32;
                }
                points.push(corner + inside * 2.0);
            }
            points.splice(1_000..1_000, cube(2.0, corner));
            let convex = Convex::of(&points).expect("a solid");
            assert_eq!(convex.corners(), (1_000..1_008).collect::<Vec<_>>());
            let (volume, centre) = convex.volume();
            assert!((volume - 8.0).abs() < 1e-4, "{volume}");
            assert!(
                (centre - (corner + 1.0).as_dvec3()).length() < 1e-5,
                "{centre}"
            );
        }
    }

    #[test]
    fn every_point_is_inside_of_every_face() {
        for seed in 1..30 {
            let mut number = numbers(seed * 977);
            let count = 20 + seed as usize * 40;
            let points: Vec<_> = (0..count)
                .map(|_| Vec3::new(number(), number() * 0.2, number() * 3.0).normalize() * 3.0)
                .collect();
            let convex = Convex::of(&points).expect("a solid");
            assert!(convex.is_complete());
            assert!(convex.corners().len() > count * 9 / 10, "a ball's surface");
            for face in &convex.faces {
                let highest = (0..count).map(|point| convex.height(face, point));
                assert!(highest.fold(0.0, f64::max) < 1e-5, "seed {seed}");
            }
            let euler = convex.faces.len() + 4;
            assert_eq!(euler, 2 * convex.corners().len(), "closed: seed {seed}");
        }
    }

    #[test]
    fn points_in_a_plane_and_too_many_corners_are_noticed() {
        let mut number = numbers(5);
        let mut plane: Vec<_> = (0..50)
            .map(|_| Vec3::new(number(), 0.5, number()))
            .collect();
        assert!(Convex::of(&plane).is_none());
        plane.push(Vec3::NAN);
        assert!(Convex::of(&plane).is_none());
        assert!(Convex::of(&[]).is_none());
        let ball: Vec<_> = (0..6_000)
            .map(|_| Vec3::new(number(), number(), number()).normalize())
            .collect();
        let convex = Convex::of(&ball).expect("a solid");
        assert!(!convex.is_complete());
        assert_eq!(convex.corners().len(), CORNERS_MAX);
    }
}
