//! The shapes that are told point by point.
//!
//! Counts are checked against the bytes that are there before anything is kept; whether numbers are finite, and indices
//! name points, is for whoever builds a solid.

use alloc::vec::Vec;

use glam::Vec3;

use crate::fields::Id;
use crate::limits::{POINTS_MAX, POSTS_MAX, TRIANGLES_MAX};
use crate::malformed::Malformed;
use crate::wire::{Field, Reader};

/// The hull of some points.
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
    /// Three points each, by place.
    pub triangles: Vec<[u32; 3]>,
}

/// A field of heights: row r and column c stand at x = r · row spacing, y = the height, z = c · column spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct Heights {
    /// The shape's name.
    pub shape: Id,
    /// How many rows.
    pub rows: u32,
    /// How many columns.
    pub columns: u32,
    /// Metres from row to row.
    pub row_spacing: f32,
    /// Metres from column to column.
    pub column_spacing: f32,
    /// Metres, row by row.
    pub heights: Vec<f32>,
}

/// A count of things of so many bytes each, for which there are bytes.
fn checked(
    count: u32,
    most: usize,
    bytes_each: usize,
    from: &Reader<'_>,
) -> Result<usize, Malformed> {
    let counted = count as usize;
    if counted > most {
        return Err(Malformed::Count(count));
    }
    if counted * bytes_each > from.left() {
        return Err(Malformed::Truncated);
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

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
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

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
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

impl Field for Heights {
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

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let shape = Id::take(from)?;
        let (rows, columns) = (u32::take(from)?, u32::take(from)?);
        let (row_spacing, column_spacing) = (f32::take(from)?, f32::take(from)?);
        let posts = rows.checked_mul(columns).ok_or(Malformed::Count(rows))?;
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
