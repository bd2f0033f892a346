//! Triangle mesh as a shape: scenery that is not convex.
//!
//! A surface, not a solid: it has no mass, so that only bodies that no engine moves may have it. Indices are checked
//! here, since engines do not. Cheap to copy: copies share their points.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, count, scalar};
use super::edges::Edges;
use crate::limits::{EXTENT_MAX, MESH_POINTS_MAX, TRIANGLES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Triangles between points, in the body's axes, metres.
#[derive(Clone, Debug)]
pub struct Mesh {
    points: Arc<[Vec3]>,
    triangles: Arc<[[u32; 3]]>,
    edges: Edges,
    /// Distance of the farthest point, metres.
    radius: f64,
}

impl Mesh {
    /// A mesh of triangles, each given by three point indices.
    ///
    /// # Errors
    ///
    /// [`Invalid`] when there are no triangles or too many, when a point index is out of range, or when a coordinate
    /// is not finite or beyond the limits.
    pub fn new(points: &[Vec3], triangles: &[[u32; 3]]) -> Result<Self, Invalid> {
        let mesh = Self::unchecked(points.to_vec(), triangles.to_vec(), Edges::default());
        mesh.check()?;
        Ok(mesh)
    }

    fn unchecked(points: Vec<Vec3>, triangles: Vec<[u32; 3]>, edges: Edges) -> Self {
        let squared = points.iter().map(|point| point.as_dvec3().length_squared());
        let radius = libm::sqrt(squared.fold(0.0, f64::max));
        Self {
            points: points.into(),
            triangles: triangles.into(),
            edges,
            radius,
        }
    }

    /// The points.
    #[must_use]
    pub fn points(&self) -> &[Vec3] {
        &self.points
    }

    /// The triangles, as point indices.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// How bodies touch the edges between its triangles.
    #[must_use]
    pub const fn edges(&self) -> Edges {
        self.edges
    }

    /// The same mesh with other edges.
    #[must_use]
    pub fn with_edges(self, edges: Edges) -> Self {
        Self { edges, ..self }
    }

    /// Radius of the least ball around the body's origin that holds the mesh.
    #[must_use]
    pub const fn bounding_radius(&self) -> Metres {
        Metres::new(self.radius)
    }

    /// Checks every number (PROTOCOL 2.6).
    pub(super) fn check(&self) -> Result<(), Invalid> {
        let points = self.points.len();
        count(points, 3, MESH_POINTS_MAX, Quantity::MeshPoints)?;
        count(self.triangles.len(), 1, TRIANGLES_MAX, Quantity::Triangles)?;
        let mut places = self.triangles.iter().flatten();
        places
            .try_for_each(|place| count(*place as usize, 0, points - 1, Quantity::TrianglePoint))?;
        let mut parts = self.points.iter().flat_map(Vec3::to_array);
        parts.try_for_each(|part| {
            scalar(part, -EXTENT_MAX, EXTENT_MAX, Quantity::Extent)
                .map_err(|wrong| wrong.of("coordinate of a mesh's point", "m"))
        })
    }
}

/// Two meshes are equal when points, triangles and edges are, in the same order.
impl PartialEq for Mesh {
    fn eq(&self, other: &Self) -> bool {
        // Copies share their arrays, and need no look at them.
        let same_points = Arc::ptr_eq(&self.points, &other.points);
        let same_triangles = Arc::ptr_eq(&self.triangles, &other.triangles);
        self.edges == other.edges
            && (same_points || self.points == other.points)
            && (same_triangles || self.triangles == other.triangles)
    }
}

impl Wire for Mesh {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.points.len() as u64);
        to.varint(self.triangles.len() as u64);
        self.edges.encode(to);
        for point in self.points.iter() {
            to.f32s(&point.to_array());
        }
        for place in self.triangles.iter().flatten() {
            to.varint(u64::from(*place));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let points = from.varint_to(MESH_POINTS_MAX as u64)? as usize;
        let count = from.varint_to(TRIANGLES_MAX as u64)? as usize;
        let edges = Edges::decode(from)?;
        // A triangle takes at least three bytes: nothing is allocated for a count without bytes.
        if points * 12 + count * 3 > from.rest().len() {
            return Err(Malformed::Truncated);
        }
        let mut corners = Vec::with_capacity(points);
        for _ in 0..points {
            corners.push(Vec3::from_array(from.f32s()?));
        }
        let mut triangles = Vec::with_capacity(count);
        for _ in 0..count {
            let mut place = || {
                from.varint_to(MESH_POINTS_MAX as u64)
                    .map(|place| place as u32)
            };
            triangles.push([place()?, place()?, place()?]);
        }
        Ok(Self::unchecked(corners, triangles, edges))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORNERS: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

    #[test]
    fn a_mesh_round_trips_and_truncations_are_refused() {
        let mesh = Mesh::new(&CORNERS, &[[0, 1, 2], [2, 1, 0]]).expect("a mesh");
        let mut writer = Writer::new();
        mesh.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes.len(), 3 + 36 + 6);
        assert_eq!(Mesh::decode(&mut Reader::new(&bytes)), Ok(mesh));
        for cut in 0..bytes.len() {
            let cut = Mesh::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn an_invalid_mesh_error_names_the_fault() {
        let wrong = |points: &[Vec3], triangles: &[[u32; 3]]| {
            Mesh::new(points, triangles).expect_err("the test makes it wrong")
        };
        let range = Invalid::out_of_range;
        assert_eq!(
            wrong(&CORNERS[..2], &[[0, 1, 1]]),
            range(Quantity::MeshPoints)
        );
        assert_eq!(wrong(&CORNERS, &[]), range(Quantity::Triangles));
        assert_eq!(
            wrong(&CORNERS, &[[0, 1, 3]]),
            range(Quantity::TrianglePoint)
        );
        let far = [Vec3::ZERO, Vec3::X * 2e4, Vec3::Y];
        assert_eq!(wrong(&far, &[[0, 1, 2]]), range(Quantity::Extent));
        let none = [Vec3::ZERO, Vec3::NAN, Vec3::Y];
        assert_eq!(
            wrong(&none, &[[0, 1, 2]]),
            Invalid::not_finite(Quantity::Extent)
        );
    }
}
