//! Scenery that is not convex: triangle meshes, and height fields.
//!
//! Surfaces, not solids: they have no mass, so that only bodies that no engine moves may have them. Indices are
//! checked here, since engines do not. Cheap to copy: copies share their points and heights.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, count, scalar};
use crate::limits::{EXTENT_MAX, EXTENT_MIN, MESH_POINTS_MAX, POSTS_MAX, TRIANGLES_MAX};
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

    /// The contact rule of the edges between its triangles.
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

/// Heights over a grid. Body's axes: row r and column c stand at x = r · row spacing, y = the height, z = c · column
/// spacing, metres; between them lie two triangles for each cell.
#[derive(Clone, Debug)]
pub struct Heights {
    rows: u32,
    columns: u32,
    row_spacing: f32,
    column_spacing: f32,
    edges: Edges,
    /// Row by row.
    heights: Arc<[f32]>,
    /// Distance of the farthest post, metres.
    radius: f64,
}

impl Heights {
    /// A field of `rows` rows, each of as many heights.
    ///
    /// # Errors
    ///
    /// [`Invalid`] when there are fewer than two rows or columns, too many posts, or another count than rows times
    /// columns; when a spacing, a height or the size of the field is not finite or beyond the limits.
    pub fn new(
        rows: u32,
        row_spacing: f32,
        column_spacing: f32,
        heights: &[f32],
    ) -> Result<Self, Invalid> {
        let posts = u32::try_from(heights.len()).unwrap_or(u32::MAX);
        let columns = posts.checked_div(rows).unwrap_or(0);
        if rows.checked_mul(columns) != Some(posts) {
            let ragged = "there are not as many heights as rows times columns";
            return Err(Invalid::because(Quantity::Posts, ragged));
        }
        let field = Self::unchecked([rows, columns], [row_spacing, column_spacing], heights);
        field.check()?;
        Ok(field)
    }

    fn unchecked([rows, columns]: [u32; 2], spacing: [f32; 2], heights: &[f32]) -> Self {
        let [row_spacing, column_spacing] = spacing;
        let mut field = Self {
            rows,
            columns,
            row_spacing,
            column_spacing,
            edges: Edges::default(),
            heights: heights.into(),
            radius: 0.0,
        };
        let squared = field.posts().map(DVec3::length_squared);
        field.radius = libm::sqrt(squared.fold(0.0, f64::max));
        field
    }

    /// Number of rows.
    #[must_use]
    pub const fn rows(&self) -> u32 {
        self.rows
    }

    /// Number of columns.
    #[must_use]
    pub const fn columns(&self) -> u32 {
        self.columns
    }

    /// Distance between rows, along x, metres.
    #[must_use]
    pub const fn row_spacing(&self) -> f32 {
        self.row_spacing
    }

    /// Distance between columns, along z, metres.
    #[must_use]
    pub const fn column_spacing(&self) -> f32 {
        self.column_spacing
    }

    /// The heights, row by row.
    #[must_use]
    pub fn heights(&self) -> &[f32] {
        &self.heights
    }

    /// Every post, row by row.
    pub fn posts(&self) -> impl Iterator<Item = DVec3> {
        let columns = self.columns.max(1) as usize;
        let spacing = [self.row_spacing, self.column_spacing].map(f64::from);
        self.heights.iter().enumerate().map(move |(place, height)| {
            let (row, column) = ((place / columns) as f64, (place % columns) as f64);
            DVec3::new(row * spacing[0], f64::from(*height), column * spacing[1])
        })
    }

    /// The contact rule of the edges between its triangles.
    #[must_use]
    pub const fn edges(&self) -> Edges {
        self.edges
    }

    /// The same field with other edges.
    #[must_use]
    pub fn with_edges(self, edges: Edges) -> Self {
        Self { edges, ..self }
    }

    /// Radius of the least ball around the body's origin that holds the field.
    #[must_use]
    pub const fn bounding_radius(&self) -> Metres {
        Metres::new(self.radius)
    }

    /// Checks every number (PROTOCOL 2.6).
    pub(super) fn check(&self) -> Result<(), Invalid> {
        let (rows, columns) = (self.rows as usize, self.columns as usize);
        let counted = |number, least, name| {
            count(number, least, POSTS_MAX, Quantity::Posts).map_err(|wrong| wrong.of(name, ""))
        };
        counted(rows, 2, "number of rows of heights")?;
        counted(columns, 2, "number of columns of heights")?;
        counted(rows.saturating_mul(columns), 4, "number of heights")?;
        let extent = |value, least, name| {
            let checked = scalar(value, least, EXTENT_MAX, Quantity::Extent);
            checked.map_err(|wrong| wrong.of(name, "m"))
        };
        extent(self.row_spacing, EXTENT_MIN, "spacing of rows of heights")?;
        let length = (self.rows - 1) as f32 * self.row_spacing;
        extent(
            length,
            EXTENT_MIN,
            "length of a height field along its rows",
        )?;
        extent(
            self.column_spacing,
            EXTENT_MIN,
            "spacing of columns of heights",
        )?;
        let length = (self.columns - 1) as f32 * self.column_spacing;
        extent(
            length,
            EXTENT_MIN,
            "length of a height field along its columns",
        )?;
        let mut heights = self.heights.iter();
        heights.try_for_each(|height| extent(*height, -EXTENT_MAX, "height"))
    }
}

/// Two fields are equal when their sizes, spacings, edges and heights are.
impl PartialEq for Heights {
    fn eq(&self, other: &Self) -> bool {
        let parameters = |field: &Self| {
            (
                field.rows,
                field.columns,
                field.row_spacing,
                field.column_spacing,
                field.edges,
            )
        };
        // Copies share their heights, and need no look at them.
        let same_heights = Arc::ptr_eq(&self.heights, &other.heights);
        parameters(self) == parameters(other) && (same_heights || self.heights == other.heights)
    }
}

impl Wire for Heights {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.rows));
        to.varint(u64::from(self.columns));
        to.f32s(&[self.row_spacing, self.column_spacing]);
        self.edges.encode(to);
        to.f32s(&self.heights);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let most = POSTS_MAX as u64;
        let (rows, columns) = (from.varint_to(most)?, from.varint_to(most)?);
        let posts = rows * columns;
        if rows < 2 || columns < 2 || posts > most {
            return Err(Malformed::OutOfRange);
        }
        let spacing = from.f32s()?;
        let edges = Edges::decode(from)?;
        let bytes = from.raw(posts as usize * 4)?;
        let heights: Vec<f32> = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect();
        let counts = [rows as u32, columns as u32];
        Ok(Self::unchecked(counts, spacing, &heights).with_edges(edges))
    }
}

/// The contact rule of the edges that two triangles of a sheet share.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Edges {
    /// Each triangle is touched as if it were alone: a body that slides or rolls over flat ground may catch on an edge.
    Plain,
    /// A contact pushes by the triangles on both sides of the edge: a body slides and rolls over flat ground as over
    /// one face. Heights are then touched from above only; a mesh from both sides.
    Smooth,
}

impl Edges {
    /// The edges of a new mesh or field.
    pub const DEFAULT: Self = Self::Smooth;
}

impl Default for Edges {
    fn default() -> Self {
        Self::DEFAULT
    }
}

impl Wire for Edges {
    fn encode(&self, to: &mut Writer) {
        to.u8(match self {
            Self::Plain => 0,
            Self::Smooth => 1,
        });
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Plain),
            1 => Ok(Self::Smooth),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec;

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

    #[test]
    fn a_height_field_round_trips_and_truncations_are_refused() {
        let field = Heights::new(2, 1.0, 2.0, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).expect("a field");
        assert_eq!((field.rows(), field.columns()), (2, 3));
        let last = field.posts().last();
        assert_eq!(last, Some(DVec3::new(1.0, 5.0, 4.0)));
        assert_eq!(field.bounding_radius().metres(), libm::sqrt(42.0));
        let mut writer = Writer::new();
        field.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(Heights::decode(&mut Reader::new(&bytes)), Ok(field));
        for cut in 0..bytes.len() {
            let cut = Heights::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn an_invalid_height_field_error_names_the_fault() {
        let posts = Err(Invalid::out_of_range(Quantity::Posts));
        let extent = Err(Invalid::out_of_range(Quantity::Extent));
        assert_eq!(Heights::new(0, 1.0, 1.0, &[]), posts);
        assert_eq!(Heights::new(1, 1.0, 1.0, &[0.0; 4]), posts);
        assert_eq!(Heights::new(4, 1.0, 1.0, &[0.0; 4]), posts);
        assert_eq!(Heights::new(2, 1.0, 1.0, &[0.0; 5]), posts);
        assert_eq!(Heights::new(2, 1.0, 1.0, &vec![0.0; POSTS_MAX + 2]), posts);
        assert_eq!(Heights::new(2, 0.0, 1.0, &[0.0; 4]), extent);
        assert_eq!(Heights::new(2, 1.0, 1.0, &[0.0, 0.0, 2e4, 0.0]), extent);
        assert_eq!(Heights::new(4, 9e3, 1.0, &[0.0; 8]), extent);
        let nan = Heights::new(2, 1.0, 1.0, &[0.0, f32::NAN, 0.0, 0.0]);
        assert_eq!(nan, Err(Invalid::not_finite(Quantity::Extent)));
    }
}
