//! Conversion of an APP client's shape into a shape of a scene.
//!
//! Checked when it is made: it can be given to an engine.

use core::f32::consts::FRAC_1_SQRT_2;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{EXTENT_MIN, POSTS_MAX};
use rhumb_protocol::scene::{Edges, Heights, Hull, Mesh, Shape};

use super::host::{Bulk, Geometry};
use super::hull::hull_of;
use super::refusal::Refusal;
use crate::wire::{ConvexMesh, HeightGrid, TriangleMesh};

/// A shape, and its pose in the axes of the client's definition.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ShapeDefinition {
    pub(super) shape: Shape,
    /// Metres, in the client's axes.
    pub(super) position: Vec3,
    /// Shape → client's axes.
    pub(super) rotation: Quat,
    pub(super) bulk: Bulk,
    /// Replacement for a dynamic body, if the shape encloses no volume.
    hull: Option<Hull>,
}

/// Long axes are the client's x and the scene's y: a quarter turn back about z.
const Y_TO_X: Quat = Quat::from_xyzw(0.0, 0.0, -FRAC_1_SQRT_2, FRAC_1_SQRT_2);

impl ShapeDefinition {
    fn of(shape: Shape, geometry: &dyn Geometry) -> Result<Self, Refusal> {
        shape.check()?;
        let bulk = geometry.bulk(&shape).ok_or(Refusal::UnusableShape)?;
        Ok(Self {
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            bulk,
            hull: None,
        })
    }

    pub(super) fn ball(
        origin: Vec3,
        radius: f32,
        geometry: &dyn Geometry,
    ) -> Result<Self, Refusal> {
        if !origin.is_finite() {
            return Err(Refusal::Number);
        }
        let ball = Self::of(Shape::Ball { radius }, geometry)?;
        Ok(Self {
            position: origin,
            ..ball
        })
    }

    /// `edges`: whole edge lengths, metres.
    pub(super) fn cuboid(edges: Vec3, geometry: &dyn Geometry) -> Result<Self, Refusal> {
        let half_extents = edges * 0.5;
        Self::of(Shape::Cuboid { half_extents }, geometry)
    }

    /// `height`: from cap to cap, so that an avatar has its intended height; at least that of the caps.
    pub(super) fn capsule(
        radius: f32,
        height: f32,
        geometry: &dyn Geometry,
    ) -> Result<Self, Refusal> {
        let half_height = (height * 0.5 - radius).max(EXTENT_MIN);
        let capsule = Shape::Capsule {
            half_height,
            radius,
        };
        Ok(Self {
            rotation: Y_TO_X,
            ..Self::of(capsule, geometry)?
        })
    }

    pub(super) fn hull(message: &ConvexMesh, geometry: &dyn Geometry) -> Result<Self, Refusal> {
        let hull = hull_of(&message.points)?;
        Self::of(Shape::Hull(hull), geometry)
    }

    /// A shape without volume has the mass of its hull, if it has one.
    pub(super) fn mesh(message: &TriangleMesh, geometry: &dyn Geometry) -> Result<Self, Refusal> {
        let mesh = Mesh::new(&message.points, &message.triangles)?;
        let hull = hull_of(&message.points).ok();
        let bulk = hull
            .as_ref()
            .and_then(|hull| geometry.bulk(&Shape::Hull(hull.clone())));
        Ok(Self {
            bulk: bulk.unwrap_or(NO_BULK),
            hull: hull.filter(|_| bulk.is_some()),
            ..Self::sheet(Shape::Mesh(mesh))
        })
    }

    pub(super) fn heights(message: &HeightGrid) -> Result<Self, Refusal> {
        if message.heights.len() > POSTS_MAX {
            return Err(Refusal::TooMany);
        }
        let field = Heights::new(
            message.rows,
            message.row_spacing,
            message.column_spacing,
            &message.heights,
        )?;
        // Hosts turn their ground as they like, and smooth heights are touched from one side alone.
        let field = field.with_edges(Edges::Plain);
        Ok(Self::sheet(Shape::Heights(field)))
    }

    /// A shape without volume or hull.
    fn sheet(shape: Shape) -> Self {
        Self {
            shape,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            bulk: NO_BULK,
            hull: None,
        }
    }

    /// The shape for a dynamic body: itself, or the hull of its points. `None` for ground.
    pub(super) fn solid(&self) -> Option<Self> {
        if self.shape.is_solid() {
            return Some(self.clone());
        }
        let shape = Shape::Hull(self.hull.clone()?);
        Some(Self {
            shape,
            ..self.clone()
        })
    }

    /// The shape around its centre of mass, and the former centre. A centre that is off by rounding only stays.
    pub(super) fn centred(&self) -> (Shape, Vec3) {
        let centre = self.bulk.centre;
        let rounding = self.shape.bounding_radius().metres() as f32 * ROUNDING;
        if let Shape::Hull(hull) = &self.shape
            && centre.length() > rounding
        {
            let points: Vec<Vec3> = hull.points().iter().map(|point| point - centre).collect();
            if let Ok(hull) = Hull::new(&points) {
                return (Shape::Hull(hull), centre);
            }
        }
        (self.shape.clone(), Vec3::ZERO)
    }
}

const NO_BULK: Bulk = Bulk {
    centre: Vec3::ZERO,
    volume: 0.0,
};
/// Share of its radius by which rounding alone may displace a hull's centre of mass.
const ROUNDING: f32 = 1e-4;
