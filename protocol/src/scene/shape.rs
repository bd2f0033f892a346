//! Shapes of bodies, compounds of shapes, and their centres of mass.
//!
//! A compound without parts touches nothing. Parts have no parts. Copies of a compound share its parts. A body's pose
//! is that of its centre of mass, and a shape is given from there: programs that have a shape from elsewhere find its
//! centre here. Masses add up as in an engine: where parts overlap, both count.

use alloc::sync::Arc;
use alloc::vec::Vec;
use core::f64::consts::PI;
use core::fmt;

use glam::{DVec3, Quat, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, count, direction, rotation, scalar, vector};
use super::points::{Convex, Heights, Hull, Mesh};
use crate::limits::{EXTENT_MAX, EXTENT_MIN, PARTS_BYTES_MAX, PARTS_MAX, SHAPES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

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
    /// A convex hull, in coordinates from the body's centre of mass: see [`Self::centred`] for points from elsewhere.
    Hull(Hull),
    /// Height field: for bodies that no engine moves.
    Heights(Heights),
    /// Triangle mesh: for bodies that no engine moves.
    Mesh(Mesh),
    /// Several shapes as one.
    Compound(Compound),
    /// A box with round edges: every point within a distance of a box.
    RoundedCuboid {
        /// Half the edge lengths of the box inside, along x, y, z.
        half_extents: Vec3,
        /// The distance, metres.
        radius: f32,
    },
    /// A cone whose tip points along y. Its base is half of `half_height` below its centre of mass.
    Cone {
        /// Half its height.
        half_height: f32,
        /// Radius of its base, metres.
        radius: f32,
    },
    /// Everything behind a plane through the body's origin: for bodies that no engine moves.
    HalfSpace {
        /// Unit vector out of it, in the body's axes.
        normal: Vec3,
    },
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

    /// A cone along y: half its height, and the radius of its base, metres.
    #[must_use]
    pub const fn cone(half_height: f32, radius: f32) -> Self {
        Self::Cone {
            half_height,
            radius,
        }
    }

    /// True if it has volume and mass: no height field, mesh or half-space, nor a compound with such a part.
    #[must_use]
    pub fn is_solid(&self) -> bool {
        match self {
            Self::Heights(_) | Self::Mesh(_) | Self::HalfSpace { .. } => false,
            Self::Compound(compound) => compound.parts().iter().all(|part| part.shape.is_solid()),
            Self::Ball { .. }
            | Self::Cuboid { .. }
            | Self::Capsule { .. }
            | Self::Cylinder { .. }
            | Self::RoundedCuboid { .. }
            | Self::Cone { .. }
            | Self::Hull(_) => true,
        }
    }

    /// True if it is one convex solid, as a character needs: no height field, mesh, half-space or compound.
    #[must_use]
    pub const fn is_convex(&self) -> bool {
        !matches!(
            self,
            Self::Heights(_) | Self::Mesh(_) | Self::HalfSpace { .. } | Self::Compound(_)
        )
    }

    /// Its size for the limits of shapes (PROTOCOL 2.6-10): the same on every machine.
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
            | Self::Cylinder { .. }
            | Self::RoundedCuboid { .. }
            | Self::Cone { .. }
            | Self::HalfSpace { .. } => 0,
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
            // A unit vector passes and fails as the quaternion of half a turn about it.
            Self::HalfSpace { normal } => return direction(normal, "normal of a half-space"),
            Self::Ball { radius } => [(radius, "radius of a ball"); 4],
            Self::Cuboid { half_extents: half } => {
                let [x, y, z] = half_extents(half);
                [x, y, z, z]
            }
            Self::RoundedCuboid {
                half_extents: half,
                radius,
            } => {
                let [x, y, z] = half_extents(half);
                [x, y, z, (radius, "radius of a rounded cuboid")]
            }
            Self::Capsule {
                half_height,
                radius,
            }
            | Self::Cylinder {
                half_height,
                radius,
            }
            | Self::Cone {
                half_height,
                radius,
            } => {
                let radius = (radius, "radius of a capsule, cylinder or cone");
                let half = (half_height, "half height of a capsule, cylinder or cone");
                [half, radius, radius, radius]
            }
        };
        for (extent, name) in extents {
            scalar(extent, EXTENT_MIN, EXTENT_MAX, Quantity::Extent)
                .map_err(|wrong| wrong.of(name, "m"))?;
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
            Self::Cuboid { half_extents } => diagonal(half_extents),
            Self::RoundedCuboid {
                half_extents,
                radius,
            } => diagonal(half_extents) + f64::from(radius),
            Self::Cone {
                half_height,
                radius,
            } => {
                let (h, r) = (f64::from(half_height), f64::from(radius));
                let base = libm::sqrt(h * 0.5 * (h * 0.5) + r * r);
                base.max(h * 1.5)
            }
            // It has no greatest extent; of a turning one more is not promised.
            Self::HalfSpace { .. } => f64::from(EXTENT_MAX),
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
    fn decode_part(from: &mut Reader<'_>) -> Result<Self, Malformed> {
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
            8 => Self::RoundedCuboid {
                half_extents: Vec3::from_array(from.f32s()?),
                radius: from.f32()?,
            },
            9 => {
                let [half_height, radius] = from.f32s()?;
                Self::Cone {
                    half_height,
                    radius,
                }
            }
            10 => Self::HalfSpace {
                normal: Vec3::from_array(from.f32s()?),
            },
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// The half extents of a box, with their names.
const fn half_extents(half: Vec3) -> [(f32, &'static str); 3] {
    [
        (half.x, "half extent of a cuboid along x"),
        (half.y, "half extent of a cuboid along y"),
        (half.z, "half extent of a cuboid along z"),
    ]
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
            Self::RoundedCuboid {
                half_extents,
                radius,
            } => {
                to.u8(8);
                to.f32s(&half_extents.to_array());
                to.f32(radius);
            }
            Self::Cone {
                half_height,
                radius,
            } => {
                to.u8(9);
                to.f32s(&[half_height, radius]);
            }
            Self::HalfSpace { normal } => {
                to.u8(10);
                to.f32s(&normal.to_array());
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

/// Distance of a box's corners from its centre, metres.
fn diagonal(half_extents: Vec3) -> f64 {
    let [x, y, z] = half_extents.to_array().map(f64::from);
    libm::sqrt(x * x + y * y + z * z)
}

/// Size of a shape without its points, heights, triangles and parts.
const SHAPE_BYTES: usize = 48;
/// Size of a part without its shape.
const PART_BYTES: usize = 80;

/// A part of a compound.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Metres, in the body's axes.
    pub position: Vec3,
    /// Part → body.
    pub rotation: Quat,
    /// Its shape; not a compound.
    pub shape: Shape,
}

/// Parts in the axes of a body, from its centre of mass.
#[derive(Clone, Debug, PartialEq)]
pub struct Compound {
    parts: Arc<[Part]>,
}

impl Compound {
    /// A compound of these parts.
    ///
    /// # Errors
    ///
    /// [`Invalid`] when they are too many, when one is a compound, or for the first invalid number.
    pub fn new(parts: Vec<Part>) -> Result<Self, Invalid> {
        let compound = Self {
            parts: parts.into(),
        };
        compound.check()?;
        Ok(compound)
    }

    /// A shape that touches nothing.
    #[must_use]
    pub fn nothing() -> Self {
        Self {
            parts: Arc::new([]),
        }
    }

    /// The parts.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Radius of a ball around the centre of mass that holds the bounding balls of all parts; at least a millimetre.
    #[must_use]
    pub fn bounding_radius(&self) -> Metres {
        let reach = |part: &Part| {
            let squared = part.position.as_dvec3().length_squared();
            libm::sqrt(squared) + part.shape.bounding_radius().metres()
        };
        let reaches = self.parts.iter().map(reach);
        Metres::new(reaches.fold(f64::from(EXTENT_MIN), f64::max))
    }

    /// Checks every number (PROTOCOL 2.6).
    fn check(&self) -> Result<(), Invalid> {
        count(self.parts.len(), 0, PARTS_MAX, Quantity::Parts)
            .map_err(|wrong| wrong.of("number of a compound's parts", ""))?;
        for part in self.parts.iter() {
            vector(part.position, EXTENT_MAX, Quantity::Extent)
                .map_err(|wrong| wrong.of("position of a compound's part", "m"))?;
            rotation(part.rotation)?;
            if matches!(part.shape, Shape::Compound(_)) {
                let nested = "a part is no compound itself; give the inner parts to the outer one";
                return Err(Invalid::because(Quantity::Parts, nested));
            }
            part.shape.check()?;
        }
        let bytes: usize = self.parts.iter().map(|part| part.shape.bytes()).sum();
        count(bytes, 0, PARTS_BYTES_MAX, Quantity::Parts)
            .map_err(|wrong| wrong.of("size of a compound's parts", "bytes"))
    }
}

impl Wire for Compound {
    fn encode(&self, to: &mut Writer) {
        debug_assert!(self.parts.len() <= PARTS_MAX, "counted when made");
        to.u8(self.parts.len() as u8);
        for part in self.parts.iter() {
            to.f32s(&part.position.to_array());
            to.f32s(&part.rotation.to_array());
            part.shape.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let count = usize::from(from.u8()?);
        if count > PARTS_MAX {
            return Err(Malformed::OutOfRange);
        }
        let mut parts = Vec::with_capacity(count);
        for _ in 0..count {
            parts.push(Part {
                position: Vec3::from_array(from.f32s()?),
                rotation: Quat::from_array(from.f32s()?),
                shape: Shape::decode_part(from)?,
            });
        }
        Ok(Self {
            parts: parts.into(),
        })
    }
}

/// The code of a compound.
const COMPOUND: u8 = 7;

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

/// Least distance of a centre from the origin that counts, as a share of the bounding radius. Rounding makes less.
const OFF_CENTRE: f64 = 1e-4;

impl Shape {
    /// The centre of mass of the shape at an even density, metres in the body's axes, if it is not the origin.
    ///
    /// The server takes the origin of a shape for its centre of mass. `None` for a shape whose centre is its origin,
    /// but for rounding, and for one without an inside. Hulls and compounds alone can have another.
    #[must_use]
    pub fn centre(&self) -> Option<Vec3> {
        let (_, centre) = weight(self)?;
        let radius = self.bounding_radius().metres();
        let is_off = libm::sqrt(centre.length_squared()) > OFF_CENTRE * radius;
        is_off.then(|| centre.as_vec3())
    }

    /// The shape moved so that its centre of mass is the origin, and where the centre was: metres in the body's axes.
    ///
    /// A body of the moved shape lies as this one would if its pose is moved by the centre, turned as the body is. A
    /// shape without another centre is returned as it is, with zero.
    #[must_use]
    pub fn centred(&self) -> (Self, Vec3) {
        let moved = self.centre().and_then(|centre| {
            let moved = match self {
                Self::Hull(hull) => {
                    let points: Vec<_> = hull.points().iter().map(|at| *at - centre).collect();
                    Self::Hull(Hull::new(&points).ok()?)
                }
                Self::Compound(compound) => {
                    let parts = compound.parts().iter().map(|part| Part {
                        position: part.position - centre,
                        ..part.clone()
                    });
                    Self::Compound(Compound::new(parts.collect()).ok()?)
                }
                _ => return None,
            };
            Some((moved, centre))
        });
        moved.unwrap_or_else(|| (self.clone(), Vec3::ZERO))
    }
}

/// Volume and centre of a solid; `None` for one without an inside.
fn weight(shape: &Shape) -> Option<(f64, DVec3)> {
    let cylinder = |half_height: f32, radius: f32| {
        let radius = f64::from(radius);
        2.0 * f64::from(half_height) * PI * radius * radius
    };
    let ball = |radius: f32| {
        let radius = f64::from(radius);
        4.0 / 3.0 * PI * radius * radius * radius
    };
    let volume = match *shape {
        Shape::Ball { radius } => ball(radius),
        // The engine weighs a rounded box as the box inside.
        Shape::Cuboid { half_extents } | Shape::RoundedCuboid { half_extents, .. } => {
            8.0 * half_extents.as_dvec3().element_product()
        }
        Shape::Capsule {
            half_height,
            radius,
        } => cylinder(half_height, radius) + ball(radius),
        Shape::Cylinder {
            half_height,
            radius,
        } => cylinder(half_height, radius),
        Shape::Cone {
            half_height,
            radius,
        } => cylinder(half_height, radius) / 3.0,
        Shape::Hull(ref hull) => {
            let (volume, centre) = Convex::of(hull.points())?.volume();
            return (volume > 0.0 && centre.is_finite()).then_some((volume, centre));
        }
        Shape::Compound(ref compound) => {
            let (mut volume, mut moment) = (0.0, DVec3::ZERO);
            for part in compound.parts() {
                let (own, centre) = weight(&part.shape)?;
                let rotation = part.rotation.as_dquat().normalize();
                volume += own;
                moment += (part.position.as_dvec3() + rotation * centre) * own;
            }
            return (volume > 0.0).then(|| (volume, moment / volume));
        }
        Shape::Heights(_) | Shape::Mesh(_) | Shape::HalfSpace { .. } => return None,
    };
    Some((volume, DVec3::ZERO))
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use glam::Quat;

    use super::*;
    use crate::scene::Mesh;

    fn part(x: f32, shape: Shape) -> Part {
        Part {
            position: Vec3::new(x, 0.0, 0.0),
            rotation: Quat::IDENTITY,
            shape,
        }
    }

    #[test]
    fn a_compound_round_trips_and_truncations_are_refused() {
        let balls = [1.0, 2.0].map(|x| part(x, Shape::Ball { radius: 0.5 }));
        let compound = Compound::new(balls.to_vec()).expect("two balls");
        assert_eq!(compound.bounding_radius().metres(), 2.5);
        let shape = Shape::Compound(compound);
        let mut writer = Writer::new();
        shape.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(Shape::decode(&mut Reader::new(&bytes)), Ok(shape));
        for cut in 0..bytes.len() {
            let cut = Shape::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn parts_of_parts_and_too_many_parts_are_refused() {
        let inner = Shape::Compound(Compound::nothing());
        let wrong = Err(Invalid::out_of_range(Quantity::Parts));
        assert_eq!(Compound::new(vec![part(0.0, inner.clone())]), wrong);
        let ball = part(0.0, Shape::Ball { radius: 0.5 });
        assert_eq!(Compound::new(vec![ball; PARTS_MAX + 1]), wrong);
        let nested = Compound {
            parts: [part(0.0, inner)].into(),
        };
        let mut writer = Writer::new();
        nested.encode(&mut writer);
        let read = Compound::decode(&mut Reader::new(&writer.into_bytes()));
        assert_eq!(read, Err(Malformed::UnknownCode));
    }

    #[test]
    fn a_compound_at_its_limits_fits_a_long_message_and_one_beyond_is_refused() {
        let points = vec![Vec3::X; 60_000];
        let triangles = vec![[59_999_u32; 3]; 60_000];
        let mesh = Shape::Mesh(Mesh::new(&points, &triangles).expect("within the limits"));
        let one = Compound::new(vec![part(0.0, mesh.clone())]).expect("within the limits");
        let mut writer = Writer::new();
        one.encode(&mut writer);
        assert!(writer.len() < crate::limits::LONG_MESSAGE_BYTES_MAX);
        let two = Compound::new(vec![part(0.0, mesh.clone()), part(1.0, mesh)]);
        assert_eq!(two, Err(Invalid::out_of_range(Quantity::Parts)));
    }

    #[test]
    fn an_empty_compound_has_a_ball_of_a_millimetre() {
        let radius = Compound::nothing().bounding_radius().metres();
        assert_eq!(radius, f64::from(EXTENT_MIN));
    }

    fn hull(points: &[[f32; 3]]) -> Shape {
        let points: Vec<_> = points.iter().map(|at| Vec3::from_array(*at)).collect();
        Shape::Hull(Hull::new(&points).expect("a solid"))
    }

    fn wedge() -> Shape {
        let ends = [0.0, 3.0];
        let corners = ends.map(|z| [[0.0, 0.0, z], [2.0, 0.0, z], [0.0, 1.0, z]]);
        hull(&corners.concat())
    }

    #[test]
    fn the_centre_of_a_wedge_and_of_a_pyramid_is_that_of_their_volume() {
        let centre = wedge().centre().expect("it is off the origin");
        assert!((centre - Vec3::new(2.0 / 3.0, 1.0 / 3.0, 1.5)).length() < 1e-6);
        let pyramid = hull(&[
            [-1.0, 0.0, -1.0],
            [1.0, 0.0, -1.0],
            [1.0, 0.0, 1.0],
            [-1.0, 0.0, 1.0],
            [0.0, 4.0, 0.0],
        ]);
        let centre = pyramid.centre().expect("it is off the origin");
        assert!((centre - Vec3::Y).length() < 1e-6);
    }

    #[test]
    fn the_centre_of_a_compound_weighs_its_parts_by_volume() {
        let part = |x: f32, shape: Shape| Part {
            position: Vec3::new(x, 0.0, 0.0),
            rotation: Quat::from_rotation_z(core::f32::consts::FRAC_PI_2),
            shape,
        };
        let angle = Compound::new(vec![
            part(0.0, Shape::cuboid(0.5, 0.5, 0.5)),
            part(4.0, Shape::cuboid(0.5, 1.5, 0.5)),
        ]);
        let shape = Shape::Compound(angle.expect("two boxes"));
        let centre = shape.centre().expect("it is off the origin");
        assert!((centre - Vec3::X * 3.0).length() < 1e-6, "{centre}");
        // The wedge's centre, turned by a quarter about z, and three metres of x.
        let turned = Compound::new(vec![part(3.0, wedge())]).expect("a wedge");
        let centre = Shape::Compound(turned)
            .centre()
            .expect("it is off the origin");
        assert!((centre - Vec3::new(3.0 - 1.0 / 3.0, 2.0 / 3.0, 1.5)).length() < 1e-6);
    }

    #[test]
    fn a_centred_shape_has_its_centre_at_the_origin_and_stays_as_it_is() {
        let (moved, centre) = wedge().centred();
        assert_eq!(moved.centre(), None);
        assert_eq!(moved.centred(), (moved.clone(), Vec3::ZERO));
        let (Shape::Hull(before), Shape::Hull(after)) = (wedge(), moved) else {
            panic!("both are hulls");
        };
        for (before, after) in before.points().iter().zip(after.points()) {
            assert!((*before - centre - *after).length() < 1e-6);
        }
        for shape in [
            Shape::ball(0.5),
            Shape::cone(1.0, 0.5),
            Shape::Compound(Compound::nothing()),
        ] {
            assert_eq!(shape.centred(), (shape.clone(), Vec3::ZERO));
        }
    }
}
