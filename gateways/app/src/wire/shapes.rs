//! Shapes of many points.
//!
//! Counts are checked against the present bytes before anything is allocated. The solid's builder checks that numbers
//! are finite and that indices name points.

use glam::Vec3;

use super::codec::{
    Field, FieldReader, Id, MalformedMessage, POINTS_MAX, POSTS_MAX, TRIANGLES_MAX,
};

/// The convex hull of points.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexMesh {
    /// The shape's name.
    pub shape: Id,
    /// Metres, in the shape's axes.
    pub points: Vec<Vec3>,
}

/// A mesh of triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct TriangleMesh {
    /// The shape's name.
    pub shape: Id,
    /// Metres, in the shape's axes.
    pub points: Vec<Vec3>,
    /// Three point indices each.
    pub triangles: Vec<[u32; 3]>,
}

/// A height field: row r and column c are at x = r · row spacing, y = the height, z = c · column spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightGrid {
    /// The shape's name.
    pub shape: Id,
    /// Number of rows.
    pub rows: u32,
    /// Number of columns.
    pub columns: u32,
    /// Distance between rows, metres.
    pub row_spacing: f32,
    /// Distance between columns, metres.
    pub column_spacing: f32,
    /// Heights, metres, row by row.
    pub heights: Vec<f32>,
}

/// A count of items of this size, checked against the present bytes.
fn checked(
    count: u32,
    most: usize,
    bytes_each: usize,
    from: &FieldReader<'_>,
) -> Result<usize, MalformedMessage> {
    let counted = count as usize;
    if counted > most {
        return Err(MalformedMessage::Count(count));
    }
    if counted * bytes_each > from.left() {
        return Err(MalformedMessage::Truncated);
    }
    Ok(counted)
}

impl Field for ConvexMesh {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        (self.points.len() as u32).put(to);
        for point in &self.points {
            point.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let points = u32::take(from)?;
        let points = checked(points, POINTS_MAX, 12, from)?;
        let points = Vec3::take_all(from, points)?;
        Ok(Self { shape, points })
    }
}

impl Field for TriangleMesh {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        (self.points.len() as u32).put(to);
        (self.triangles.len() as u32).put(to);
        for point in &self.points {
            point.put(to);
        }
        for triangle in &self.triangles {
            triangle.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let points = u32::take(from)?;
        let triangles = u32::take(from)?;
        let points = checked(points, POINTS_MAX, 12, from)?;
        let points = Vec3::take_all(from, points)?;
        let triangles = checked(triangles, TRIANGLES_MAX, 12, from)?;
        let triangles = <[u32; 3]>::take_all(from, triangles)?;
        Ok(Self {
            shape,
            points,
            triangles,
        })
    }
}

impl Field for HeightGrid {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        self.rows.put(to);
        self.columns.put(to);
        self.row_spacing.put(to);
        self.column_spacing.put(to);
        for height in &self.heights {
            height.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let (rows, columns) = (u32::take(from)?, u32::take(from)?);
        let (row_spacing, column_spacing) = (f32::take(from)?, f32::take(from)?);
        let posts = rows
            .checked_mul(columns)
            .ok_or(MalformedMessage::Count(rows))?;
        let posts = checked(posts, POSTS_MAX, 4, from)?;
        let heights = f32::take_all(from, posts)?;
        Ok(Self {
            shape,
            rows,
            columns,
            row_spacing,
            column_spacing,
            heights,
        })
    }
}
