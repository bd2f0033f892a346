//! Shapes and bodies as flat structs of C.

use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{
    BodyKind, CollisionGroups, Compound, Edges, Heights, Hull, LockedAxes, Material, Mesh, Part,
    Shape, Sleep, SleepThresholds,
};
use rhumb_bindings::rhumb_client::{Damping, ToleranceScale};
use rhumb_bindings::{BindingError, BodyParams};

use crate::border::{RhumbCode, elements, guard, one_of, value, write};
use crate::kinds::{BODY_KINDS, EDGES, RhumbShapeKind, RhumbSleep};

/// A body of a scene, for as long as the scene lives. Zero is no body.
///
/// The server gives the numbers out: one more than an index below 1,048,576, with a generation above the low 33 bits.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RhumbBody(pub u64);

/// A shape. Fields that its kind does not name are ignored. Lengths are in the scene's unit.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbShape {
    /// A `RhumbShapeKind`.
    pub kind: u32,
    /// Half the edge lengths along the axes.
    pub half_extents: [f32; 3],
    /// Half the length along the axis that points up.
    pub half_height: f32,
    /// Radius.
    pub radius: f32,
    /// Unit vector out of a half-space.
    pub normal: [f32; 3],
    /// Three coordinates for each point, or one height for each post.
    pub points: *const f32,
    /// Number of points or posts, not of floats.
    pub point_count: usize,
    /// Three places of points for each triangle.
    pub triangles: *const u32,
    /// Number of triangles.
    pub triangle_count: usize,
    /// Rows of posts.
    pub rows: u32,
    /// Distance between rows.
    pub row_spacing: f32,
    /// Distance between the posts of a row.
    pub column_spacing: f32,
    /// A `RhumbEdges`, of a mesh or heights.
    pub edges: u32,
    /// Parts of a compound.
    pub parts: *const RhumbPart,
    /// Number of parts.
    pub part_count: usize,
}

/// A part of a compound shape, in the axes of its body.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbPart {
    /// From the origin of the compound, in the scene's unit of length.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w: part to body.
    pub rotation: [f32; 4],
    /// Its shape, which is not a compound.
    pub shape: *const RhumbShape,
}

/// A body to add. Begin with `rhumb_body_desc_init`, which makes a plain one.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbBodyDesc {
    /// A `RhumbBodyKind`.
    pub kind: u32,
    /// Its shape.
    pub shape: RhumbShape,
    /// Origin of its shape, which is its centre of mass but for hulls and compounds, in the scene's unit of length.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w: body to world.
    pub rotation: [f32; 4],
    /// Velocity of the centre of mass, units of length per second.
    pub linear_velocity: [f32; 3],
    /// Spin about world axes, rad/s.
    pub angular_velocity: [f32; 3],
    /// Not zero: `friction`, `restitution` and `density` replace those of the scene.
    pub has_material: u8,
    /// Not zero: `linear_damping` and `angular_damping` replace those of the scene.
    pub has_damping: u8,
    /// Not zero: `mass` replaces volume times density.
    pub has_mass: u8,
    /// Not zero: `moments` replace those of the shape, which go with the mass. Needs a mass.
    pub has_moments: u8,
    /// Not zero: bodies pass through it.
    pub sensor: u8,
    /// Not zero: it is swept against moving bodies, so that it does not pass through them.
    pub swept: u8,
    /// Zero: its axis of spin stays, though its moments of inertia differ.
    pub gyroscopic: u8,
    /// Coulomb coefficient.
    pub friction: f32,
    /// Share of the closing speed that is returned, 0 to 1.
    pub restitution: f32,
    /// kg/m³, whatever the scene's unit of length.
    pub density: f32,
    /// 1/s.
    pub linear_damping: f32,
    /// 1/s.
    pub angular_damping: f32,
    /// Kilograms.
    pub mass: f32,
    /// Moments of inertia about the body's axes x, y, z, kg·m² whatever the scene's unit of length.
    pub moments: [f32; 3],
    /// Factor on the scene's gravity.
    pub gravity_scale: f32,
    /// World axes along or about which the engine does not move it: bits 0 to 2 for translations along x, y, z, bits 3 to 5
    /// for rotations about them.
    pub locked_axes: u32,
    /// One bit for each collision group of the body.
    pub group_members: u32,
    /// One bit for each collision group that the body touches.
    pub group_touches: u32,
    /// Power of two on the tolerance of its copies, -3 to 3.
    pub tolerance_exponent: i32,
    /// A `RhumbSleep`.
    pub sleep: u32,
    /// Speed of its fastest point, units of length per second.
    pub sleep_speed: f32,
    /// rad/s.
    pub sleep_angular_speed: f32,
    /// Seconds for which it must be as slow as that.
    pub sleep_seconds: f32,
}

/// Makes a plain description: a dynamic ball of radius one half, at rest at the origin.
///
/// # Safety
///
/// `desc` points to memory for a `RhumbBodyDesc`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_body_desc_init(desc: *mut RhumbBodyDesc) -> RhumbCode {
    // SAFETY: the caller promises the memory.
    guard(|| unsafe { write(desc, RhumbBodyDesc::PLAIN, "desc") })
}

/// The centre of mass of a shape of even density, three coordinates from its origin in its own axes. Hulls and compounds
/// alone have another than their origin.
///
/// A body of such a shape is placed by its origin, and so is every pose of it that this client gives and gets; forces act at
/// the centre. Other members see the body from its centre of mass.
///
/// # Safety
///
/// `shape` points to a `RhumbShape`, its pointers to as much as it says, and `centre` to memory for three floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_shape_centre(
    shape: *const RhumbShape,
    centre: *mut f32,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the shape and what it points to.
        let found = unsafe { value(shape, "shape")?.shape()? }.centre();
        let found = found.unwrap_or_default().to_array();
        // SAFETY: the caller promises the memory.
        unsafe { write(centre.cast::<[f32; 3]>(), found, "centre") }
    })
}

impl RhumbShape {
    pub(crate) const PLAIN: Self = Self {
        kind: RhumbShapeKind::Ball as u32,
        half_extents: [0.5; 3],
        half_height: 0.5,
        radius: 0.5,
        normal: [0.0, 1.0, 0.0],
        points: std::ptr::null(),
        point_count: 0,
        triangles: std::ptr::null(),
        triangle_count: 0,
        rows: 0,
        row_spacing: 1.0,
        column_spacing: 1.0,
        edges: Edges::DEFAULT as u32,
        parts: std::ptr::null(),
        part_count: 0,
    };

    /// The shape that the fields describe.
    ///
    /// # Safety
    ///
    /// `points`, `triangles` and `parts` point to as many elements as the fields say, if the kind needs them; and so on in
    /// the parts.
    pub(crate) unsafe fn shape(&self) -> Result<Shape, BindingError> {
        if self.kind != RhumbShapeKind::Compound as u32 {
            // SAFETY: the caller promises the points and the triangles.
            return unsafe { self.simple() };
        }
        // SAFETY: the caller promises the parts.
        let parts = unsafe { elements(self.parts, self.part_count, "shape.parts") }?;
        let parts = parts.iter().map(|part| {
            Ok(Part {
                position: Vec3::from_array(part.position),
                rotation: Quat::from_array(part.rotation),
                // SAFETY: the caller promises the shapes of the parts, and what they point to.
                shape: unsafe { value(part.shape, "part.shape")?.simple() }?,
            })
        });
        let parts = parts.collect::<Result<Vec<_>, BindingError>>()?;
        Ok(Shape::Compound(Compound::new(parts)?))
    }

    /// The shape that the fields describe, unless it is a compound.
    ///
    /// # Safety
    ///
    /// As [`Self::shape`].
    unsafe fn simple(&self) -> Result<Shape, BindingError> {
        let half_extents = Vec3::from_array(self.half_extents);
        let (half_height, radius) = (self.half_height, self.radius);
        Ok(
            match one_of(&RhumbShapeKind::EACH, self.kind, "shape.kind")? {
                RhumbShapeKind::Ball => Shape::ball(radius),
                RhumbShapeKind::Cuboid => Shape::Cuboid { half_extents },
                RhumbShapeKind::Capsule => Shape::capsule(half_height, radius),
                RhumbShapeKind::Cylinder => Shape::cylinder(half_height, radius),
                RhumbShapeKind::Cone => Shape::cone(half_height, radius),
                RhumbShapeKind::RoundedCuboid => Shape::RoundedCuboid {
                    half_extents,
                    radius,
                },
                RhumbShapeKind::HalfSpace => Shape::HalfSpace {
                    normal: Vec3::from_array(self.normal),
                },
                // SAFETY: the caller promises the points.
                RhumbShapeKind::Hull => Shape::Hull(Hull::new(&unsafe { self.points() }?)?),
                RhumbShapeKind::Mesh => {
                    let corners = self.triangle_count.saturating_mul(3);
                    // SAFETY: the caller promises the points and the triangles.
                    let (points, corners) = unsafe {
                        (
                            self.points()?,
                            elements(self.triangles, corners, "shape.triangles")?,
                        )
                    };
                    let triangles: Vec<[u32; 3]> = corners.as_chunks().0.to_vec();
                    let mesh = Mesh::new(&points, &triangles)?;
                    Shape::Mesh(mesh.with_edges(self.edges()?))
                }
                RhumbShapeKind::Heights => {
                    // SAFETY: the caller promises one number for each post.
                    let heights =
                        unsafe { elements(self.points, self.point_count, "shape.points") }?;
                    let field =
                        Heights::new(self.rows, self.row_spacing, self.column_spacing, heights);
                    Shape::Heights(field?.with_edges(self.edges()?))
                }
                RhumbShapeKind::Compound => {
                    return Err(BindingError::Argument {
                        argument: "part.shape.kind",
                        needed: "of a shape without parts",
                    });
                }
            },
        )
    }

    fn edges(&self) -> Result<Edges, BindingError> {
        one_of(&EDGES, self.edges, "shape.edges")
    }

    /// The points of a hull or mesh.
    ///
    /// # Safety
    ///
    /// `points` points to three numbers for each point.
    unsafe fn points(&self) -> Result<Vec<Vec3>, BindingError> {
        let numbers = self.point_count.saturating_mul(3);
        // SAFETY: the caller promises the numbers.
        let numbers = unsafe { elements(self.points, numbers, "shape.points") }?;
        let points = numbers.as_chunks().0.iter();
        Ok(points.copied().map(Vec3::from_array).collect())
    }
}

/// Conditions of sleep out of their fields; `None` for those of the scene.
pub(crate) fn sleep(
    rule: u32,
    [speed, angular_speed, seconds]: [f32; 3],
    argument: &'static str,
) -> Result<Option<Sleep>, BindingError> {
    Ok(match one_of(&RhumbSleep::EACH, rule, argument)? {
        RhumbSleep::Default => None,
        RhumbSleep::Settled => Some(Sleep::Settled),
        RhumbSleep::Below => Some(Sleep::Below(SleepThresholds {
            speed,
            angular_speed,
            seconds,
        })),
        RhumbSleep::Never => Some(Sleep::Never),
    })
}

impl RhumbBodyDesc {
    const PLAIN: Self = Self {
        kind: 0,
        shape: RhumbShape::PLAIN,
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
        linear_velocity: [0.0; 3],
        angular_velocity: [0.0; 3],
        has_material: 0,
        has_damping: 0,
        has_mass: 0,
        has_moments: 0,
        sensor: 0,
        swept: 0,
        gyroscopic: 1,
        friction: 0.5,
        restitution: 0.0,
        density: 1_000.0,
        linear_damping: 0.0,
        angular_damping: 0.0,
        mass: 1.0,
        moments: [1.0; 3],
        gravity_scale: 1.0,
        locked_axes: 0,
        group_members: u32::MAX,
        group_touches: u32::MAX,
        tolerance_exponent: 0,
        sleep: RhumbSleep::Default as u32,
        sleep_speed: 0.0,
        sleep_angular_speed: 0.0,
        sleep_seconds: 0.0,
    };

    /// The body that the fields describe.
    ///
    /// # Safety
    ///
    /// As [`RhumbShape::shape`].
    pub(crate) unsafe fn params(&self) -> Result<BodyParams, BindingError> {
        let kind: BodyKind = one_of(&BODY_KINDS, self.kind, "kind")?;
        // SAFETY: the caller promises what the shape points to.
        let shape = unsafe { self.shape.shape() }?;
        let locked = u8::try_from(self.locked_axes)
            .ok()
            .and_then(LockedAxes::new);
        let exponent = i8::try_from(self.tolerance_exponent).ok();
        Ok(BodyParams {
            position: Vec3::from_array(self.position),
            rotation: Quat::from_array(self.rotation),
            linear_velocity: Vec3::from_array(self.linear_velocity),
            angular_velocity: Vec3::from_array(self.angular_velocity),
            material: (self.has_material != 0).then_some(Material {
                friction: self.friction,
                restitution: self.restitution,
                density: self.density,
            }),
            damping: (self.has_damping != 0).then_some(Damping {
                linear: self.linear_damping,
                angular: self.angular_damping,
            }),
            mass: (self.has_mass != 0).then_some(self.mass),
            moments: (self.has_moments != 0).then_some(Vec3::from_array(self.moments)),
            gravity_scale: self.gravity_scale,
            locked_axes: locked.ok_or_else(|| {
                BindingError::value("locked_axes", self.locked_axes, "six bits: 0 to 63")
            })?,
            groups: CollisionGroups {
                members: self.group_members,
                touches: self.group_touches,
            },
            tolerance_scale: exponent.and_then(ToleranceScale::new).ok_or_else(|| {
                let found = self.tolerance_exponent;
                BindingError::value("tolerance_exponent", found, "-3 to 3")
            })?,
            sensor: self.sensor != 0,
            swept: self.swept != 0,
            gyroscopic: self.gyroscopic != 0,
            sleep: sleep(
                self.sleep,
                [
                    self.sleep_speed,
                    self.sleep_angular_speed,
                    self.sleep_seconds,
                ],
                "sleep",
            )?,
            ..BodyParams::new(kind, shape)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error of a description, as text.
    fn error(desc: RhumbBodyDesc) -> String {
        // SAFETY: no description of these tests points to less than it says.
        let params = unsafe { desc.params() };
        params.expect_err("the description is wrong").to_string()
    }

    #[test]
    fn a_plain_description_is_a_plain_body() {
        // SAFETY: a ball points to nothing.
        let params = unsafe { RhumbBodyDesc::PLAIN.params() }.unwrap();
        assert_eq!(params, BodyParams::new(BodyKind::Dynamic, Shape::ball(0.5)));
    }

    #[test]
    fn wrong_descriptions_are_errors_that_name_the_field() {
        let plain = RhumbBodyDesc::PLAIN;
        let shape = |kind: RhumbShapeKind| RhumbShape {
            kind: kind as u32,
            ..RhumbShape::PLAIN
        };
        let desc = |shape| RhumbBodyDesc { shape, ..plain };
        assert!(
            error(RhumbBodyDesc { kind: 3, ..plain }).starts_with("kind is 3, and must be 0 to 2")
        );
        assert!(
            error(RhumbBodyDesc {
                locked_axes: 64,
                ..plain
            })
            .starts_with("locked_axes")
        );
        assert!(
            error(RhumbBodyDesc {
                tolerance_exponent: 99,
                ..plain
            })
            .starts_with("tolerance")
        );
        let unknown = RhumbShape {
            kind: 77,
            ..RhumbShape::PLAIN
        };
        assert!(error(desc(unknown)).starts_with("shape.kind"));
        let hull = RhumbShape {
            point_count: 4,
            ..shape(RhumbShapeKind::Hull)
        };
        assert_eq!(error(desc(hull)), "shape.points must not be null");
        let endless = RhumbShape {
            point_count: usize::MAX,
            ..shape(RhumbShapeKind::Mesh)
        };
        assert!(error(desc(endless)).starts_with("shape.points must be shorter"));
    }

    #[test]
    fn the_parts_of_a_compound_are_read_and_have_no_parts() {
        let plain = RhumbShape::PLAIN;
        let ball = RhumbPart {
            position: [1.0, 2.0, 3.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
            shape: &raw const plain,
        };
        let parts = [ball, ball];
        let compound = RhumbShape {
            kind: RhumbShapeKind::Compound as u32,
            parts: parts.as_ptr(),
            part_count: 2,
            ..RhumbShape::PLAIN
        };
        let desc = |shape| RhumbBodyDesc {
            shape,
            ..RhumbBodyDesc::PLAIN
        };
        // SAFETY: the pointer has as many parts as the count says.
        let shape = unsafe { compound.shape() }.unwrap();
        let Shape::Compound(read) = shape else {
            panic!("a compound stays a compound");
        };
        assert_eq!(read.parts()[1].position, Vec3::new(1.0, 2.0, 3.0));
        let nested = [RhumbPart {
            shape: &raw const compound,
            ..ball
        }];
        let nested = RhumbShape {
            parts: nested.as_ptr(),
            part_count: 1,
            ..compound
        };
        assert!(error(desc(nested)).starts_with("part.shape.kind"));
        let null = RhumbShape {
            parts: std::ptr::null(),
            ..compound
        };
        assert_eq!(error(desc(null)), "shape.parts must not be null");
    }

    #[test]
    fn points_and_triangles_are_read_as_the_counts_say() {
        let none = RhumbShape {
            kind: RhumbShapeKind::Heights as u32,
            ..RhumbShape::PLAIN
        };
        let none = RhumbBodyDesc {
            shape: none,
            ..RhumbBodyDesc::PLAIN
        };
        assert!(error(none).contains("heights"));
        let points: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
        let triangles = [0_u32, 1, 2, 0, 2, 3];
        let of_kind = |kind: RhumbShapeKind| RhumbShape {
            kind: kind as u32,
            points: points.as_ptr(),
            point_count: 4,
            triangles: triangles.as_ptr(),
            triangle_count: 2,
            rows: 2,
            ..RhumbShape::PLAIN
        };
        // SAFETY: the arrays have as many numbers as the counts say; heights are the first four.
        let [hull, mesh, heights] = [
            RhumbShapeKind::Hull,
            RhumbShapeKind::Mesh,
            RhumbShapeKind::Heights,
        ]
        .map(|kind| unsafe { of_kind(kind).shape() }.unwrap());
        assert!(matches!(hull, Shape::Hull(hull) if hull.points().len() == 4));
        assert!(matches!(mesh, Shape::Mesh(mesh) if mesh.triangles() == [[0, 1, 2], [0, 2, 3]]));
        assert!(
            matches!(heights, Shape::Heights(field) if field.heights() == [0.0, 0.0, 0.0, 1.0])
        );
    }
}
