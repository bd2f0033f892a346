//! Shapes of many points: convex hulls, triangle meshes, height fields.
//!
//! A hull does not know its faces: engines find them. One pass over the points checks them; only the engine can
//! tell whether a solid can be made of them. Cheap to copy: copies share their points. Corners are found by adding the
//! farthest point to a solid until none is outside. Points that lie within rounding of a face count as inside.
//!
//! Meshes and height fields are surfaces, not solids: they have no mass, so that only bodies that no engine moves may
//! have them. Indices are checked here, since engines do not. Cheap to copy: copies share their points and heights.

use alloc::sync::Arc;
use alloc::vec;
use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, Rule, count, outside, scalar};
use crate::limits::{
    EXTENT_MAX, EXTENT_MIN, HULL_FLATNESS, HULL_POINTS_MAX, HULL_POINTS_MIN, MESH_POINTS_MAX,
    POSTS_MAX, TRIANGLES_MAX,
};
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

    /// Triangles of the convex hull of some points, each with the places of its corners, counterclockwise from outside;
    /// `None` for points that are not finite, or within rounding of a plane.
    #[must_use]
    pub fn triangles_of(points: &[Vec3]) -> Option<Vec<[usize; 3]>> {
        let convex = Convex::of(points)?;
        Some(convex.faces.iter().map(|face| face.corners).collect())
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
mod tests;
