//! Shapes of bodies.

use core::fmt;

use glam::Vec3;
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, scalar};
use super::compound::Compound;
use super::heights::Heights;
use super::hull::Hull;
use super::mesh::Mesh;
use crate::limits::{EXTENT_MAX, EXTENT_MIN, SHAPES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Names a shape of one scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ShapeId(pub u32);

impl fmt::Display for ShapeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "shape {}", self.0)
    }
}

impl Wire for ShapeId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let number = from.varint_to(u64::from(SHAPES_MAX) - 1)?;
        Ok(Self(number as u32))
    }
}

/// A solid, centred on its body's centre of mass. Lengths in metres; long axes along the body's y.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A sphere.
    Ball {
        /// Metres.
        radius: f32,
    },
    /// A box.
    Cuboid {
        /// Half the edge lengths along x, y, z.
        half_extents: Vec3,
    },
    /// A cylinder with half balls on its ends.
    Capsule {
        /// Half the length of the straight part.
        half_height: f32,
        /// Radius of the cylinder and the balls, metres.
        radius: f32,
    },
    /// A cylinder.
    Cylinder {
        /// Half its length.
        half_height: f32,
        /// Metres.
        radius: f32,
    },
    /// A convex hull, in coordinates from the body's centre of mass.
    Hull(Hull),
    /// Height field: for bodies that no engine moves.
    Heights(Heights),
    /// Triangle mesh: for bodies that no engine moves.
    Mesh(Mesh),
    /// Several shapes as one.
    Compound(Compound),
}

impl Shape {
    /// A sphere of this radius, metres.
    #[must_use]
    pub const fn ball(radius: f32) -> Self {
        Self::Ball { radius }
    }

    /// A box of these half edge lengths along x, y and z, metres.
    #[must_use]
    pub const fn cuboid(x: f32, y: f32, z: f32) -> Self {
        Self::Cuboid {
            half_extents: Vec3::new(x, y, z),
        }
    }

    /// A capsule along y: half the length of its straight part, and its radius, metres.
    #[must_use]
    pub const fn capsule(half_height: f32, radius: f32) -> Self {
        Self::Capsule {
            half_height,
            radius,
        }
    }

    /// A cylinder along y: half its length, and its radius, metres.
    #[must_use]
    pub const fn cylinder(half_height: f32, radius: f32) -> Self {
        Self::Cylinder {
            half_height,
            radius,
        }
    }

    /// Whether it has volume and mass: neither a height field nor a mesh, nor a compound with such a part.
    #[must_use]
    pub fn is_solid(&self) -> bool {
        match self {
            Self::Heights(_) | Self::Mesh(_) => false,
            Self::Compound(compound) => compound.parts().iter().all(|part| part.shape.is_solid()),
            Self::Ball { .. }
            | Self::Cuboid { .. }
            | Self::Capsule { .. }
            | Self::Cylinder { .. }
            | Self::Hull(_) => true,
        }
    }

    /// Its size for the limits of shapes (PROTOCOL 2.6-18): the same on every machine.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let own = match self {
            Self::Hull(hull) => size_of_val(hull.points()),
            Self::Heights(heights) => size_of_val(heights.heights()),
            Self::Mesh(mesh) => size_of_val(mesh.points()) + size_of_val(mesh.triangles()),
            Self::Compound(compound) => {
                let parts = compound.parts().iter();
                parts.map(|part| PART_BYTES + part.shape.bytes()).sum()
            }
            Self::Ball { .. }
            | Self::Cuboid { .. }
            | Self::Capsule { .. }
            | Self::Cylinder { .. } => 0,
        };
        SHAPE_BYTES + own
    }

    /// Checks every length.
    ///
    /// # Errors
    ///
    /// [`Invalid`] for an extent that is not finite or outside the limits.
    pub fn check(&self) -> Result<(), Invalid> {
        let extents = match *self {
            Self::Hull(ref hull) => return hull.check(),
            Self::Heights(ref heights) => return heights.check(),
            Self::Mesh(ref mesh) => return mesh.check(),
            Self::Compound(ref compound) => return compound.check(),
            Self::Ball { radius } => [radius; 3],
            Self::Cuboid { half_extents } => half_extents.to_array(),
            Self::Capsule {
                half_height,
                radius,
            }
            | Self::Cylinder {
                half_height,
                radius,
            } => [half_height, radius, radius],
        };
        for extent in extents {
            scalar(extent, EXTENT_MIN, EXTENT_MAX, Quantity::Extent)?;
        }
        Ok(())
    }

    /// Radius of the least ball around the centre of mass that holds the shape (RECKONING 4.5).
    #[must_use]
    pub fn bounding_radius(&self) -> Metres {
        Metres::new(match *self {
            Self::Hull(ref hull) => return hull.bounding_radius(),
            Self::Heights(ref heights) => return heights.bounding_radius(),
            Self::Mesh(ref mesh) => return mesh.bounding_radius(),
            Self::Compound(ref compound) => return compound.bounding_radius(),
            Self::Ball { radius } => f64::from(radius),
            Self::Cuboid { half_extents } => {
                let [x, y, z] = half_extents.to_array().map(f64::from);
                libm::sqrt(x * x + y * y + z * z)
            }
            Self::Capsule {
                half_height,
                radius,
            } => f64::from(half_height) + f64::from(radius),
            Self::Cylinder {
                half_height,
                radius,
            } => {
                let (h, r) = (f64::from(half_height), f64::from(radius));
                libm::sqrt(h * h + r * r)
            }
        })
    }

    /// Decodes a part of a compound: any shape but a compound.
    pub(super) fn decode_part(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => Self::Ball {
                radius: from.f32()?,
            },
            1 => Self::Cuboid {
                half_extents: Vec3::from_array(from.f32s()?),
            },
            2 => {
                let [half_height, radius] = from.f32s()?;
                Self::Capsule {
                    half_height,
                    radius,
                }
            }
            3 => {
                let [half_height, radius] = from.f32s()?;
                Self::Cylinder {
                    half_height,
                    radius,
                }
            }
            4 => Self::Hull(Hull::decode(from)?),
            5 => Self::Heights(Heights::decode(from)?),
            6 => Self::Mesh(Mesh::decode(from)?),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

impl Wire for Shape {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Ball { radius } => {
                to.u8(0);
                to.f32(radius);
            }
            Self::Cuboid { half_extents } => {
                to.u8(1);
                to.f32s(&half_extents.to_array());
            }
            Self::Capsule {
                half_height,
                radius,
            } => {
                to.u8(2);
                to.f32s(&[half_height, radius]);
            }
            Self::Cylinder {
                half_height,
                radius,
            } => {
                to.u8(3);
                to.f32s(&[half_height, radius]);
            }
            Self::Hull(ref hull) => {
                to.u8(4);
                hull.encode(to);
            }
            Self::Heights(ref heights) => {
                to.u8(5);
                heights.encode(to);
            }
            Self::Mesh(ref mesh) => {
                to.u8(6);
                mesh.encode(to);
            }
            Self::Compound(ref compound) => {
                to.u8(COMPOUND);
                compound.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        if from.rest().first() != Some(&COMPOUND) {
            return Self::decode_part(from);
        }
        from.u8()?;
        Compound::decode(from).map(Self::Compound)
    }
}

/// The code of a compound.
const COMPOUND: u8 = 7;
/// What a shape counts beside its points, heights, triangles and parts.
const SHAPE_BYTES: usize = 48;
/// What a part counts beside its shape.
const PART_BYTES: usize = 80;
