//! Vectors, rotations and shapes between Godot's types and the client's.
//!
//! Axes and units come from `rhumb-bindings`, the one place that has them for every engine: vectors and rotations change
//! their types alone. A shape of Godot may be placed otherwise than the body's origin: [`NodeShape`] says where that lies.

use std::collections::HashMap;
use std::fmt;

use godot::builtin::{PackedFloat32Array, PackedVector3Array, Plane, Quaternion, Vector3};
use godot::classes::{
    BoxShape3D, CapsuleShape3D, ConcavePolygonShape3D, ConvexPolygonShape3D, CylinderShape3D,
    HeightMapShape3D, Shape3D, SphereShape3D, WorldBoundaryShape3D,
};
use godot::obj::{Gd, Inherits, NewGd};
use rhumb_bindings::{BindingError, Coordinates};
use rhumb_client::glam::{DVec3, Quat, Vec3};
use rhumb_client::scene::{Edges, Heights, Hull, Invalid, Mesh, Shape};

/// The coordinates of Godot.
pub(crate) const AXES: Coordinates = Coordinates::GODOT;

/// A vector of Godot.
pub(crate) fn vec3(vector: Vector3) -> Vec3 {
    Vec3::new(vector.x, vector.y, vector.z)
}

/// A rotation of Godot.
pub(crate) fn quat(rotation: Quaternion) -> Quat {
    Quat::from_xyzw(rotation.x, rotation.y, rotation.z, rotation.w)
}

/// A vector in Godot's axes.
pub(crate) fn vector(vector: Vec3) -> Vector3 {
    Vector3::new(vector.x, vector.y, vector.z)
}

/// A rotation in Godot's axes.
pub(crate) fn quaternion(rotation: Quat) -> Quaternion {
    Quaternion::new(rotation.x, rotation.y, rotation.z, rotation.w)
}

/// Half the straight part of a shorter capsule is below the protocol's least length: it is a ball.
const CAPSULE_MIN: f32 = 1e-3;

/// A shape of the protocol that a resource of Godot describes.
pub(crate) struct NodeShape {
    pub(crate) shape: Shape,
    /// The body's origin, in the axes of the node that has the resource.
    pub(crate) origin: Vec3,
}

/// Properties that describe no body.
#[derive(Debug)]
pub(crate) enum DescriptionError {
    /// The node has none.
    Missing,
    /// Its transform has no rotation.
    Pose,
    /// The class of the resource is not known.
    Class(String),
    Invalid(BindingError),
}

impl fmt::Display for DescriptionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Missing => f.write_str("it has no shape: set the property `shape`"),
            Self::Pose => {
                f.write_str("its transform has no rotation: its scale is zero or not finite")
            }
            Self::Class(class) => write!(f, "a body cannot have a {class}"),
            Self::Invalid(invalid) => invalid.fmt(f),
        }
    }
}

impl From<BindingError> for DescriptionError {
    fn from(error: BindingError) -> Self {
        Self::Invalid(error)
    }
}

impl From<Invalid> for DescriptionError {
    fn from(invalid: Invalid) -> Self {
        Self::Invalid(invalid.into())
    }
}

/// The shape that a resource describes. `edges`: those between triangles, if it has some.
pub(crate) fn node_shape(
    resource: &Gd<Shape3D>,
    edges: Edges,
) -> Result<NodeShape, DescriptionError> {
    let plain = |shape| NodeShape {
        shape,
        origin: Vec3::ZERO,
    };
    if let Some(ball) = cast::<SphereShape3D>(resource) {
        return Ok(plain(Shape::ball(ball.get_radius())));
    }
    if let Some(cuboid) = cast::<BoxShape3D>(resource) {
        let half = vec3(cuboid.get_size()) * 0.5;
        return Ok(plain(Shape::cuboid(half.x, half.y, half.z)));
    }
    if let Some(capsule) = cast::<CapsuleShape3D>(resource) {
        // Godot's height is of the whole capsule, with its ends.
        let radius = capsule.get_radius();
        let half_height = 0.5 * capsule.get_height() - radius;
        if half_height < CAPSULE_MIN {
            return Ok(plain(Shape::ball(radius)));
        }
        return Ok(plain(Shape::capsule(half_height, radius)));
    }
    if let Some(cylinder) = cast::<CylinderShape3D>(resource) {
        let half_height = 0.5 * cylinder.get_height();
        return Ok(plain(Shape::cylinder(half_height, cylinder.get_radius())));
    }
    if let Some(hull) = cast::<ConvexPolygonShape3D>(resource) {
        return Ok(plain(Shape::Hull(Hull::new(&points(&hull.get_points()))?)));
    }
    if let Some(mesh) = cast::<ConcavePolygonShape3D>(resource) {
        let mesh = mesh_of(&points(&mesh.get_faces()))?;
        return Ok(plain(Shape::Mesh(mesh.with_edges(edges))));
    }
    if let Some(heights) = cast::<HeightMapShape3D>(resource) {
        return heights_of(&heights, edges);
    }
    if let Some(boundary) = cast::<WorldBoundaryShape3D>(resource) {
        let plane = boundary.get_plane();
        // Its points p have normal · p = d, for a normal of any length.
        let length = vec3(plane.normal).length();
        let normal = vec3(plane.normal) / length;
        return Ok(NodeShape {
            shape: Shape::HalfSpace { normal },
            origin: normal * (plane.d / length),
        });
    }
    Err(DescriptionError::Class(resource.get_class().to_string()))
}

/// A resource that shows a shape; `None` for one that no class of Godot describes: a cone, a rounded box, a compound.
///
/// A height field is given by its triangles, because Godot's own stands around its middle.
pub(crate) fn resource(shape: &Shape) -> Option<Gd<Shape3D>> {
    Some(match shape {
        Shape::Ball { radius } => made::<SphereShape3D>(|ball| ball.set_radius(*radius)),
        Shape::Cuboid { half_extents } => {
            made::<BoxShape3D>(|cuboid| cuboid.set_size(vector(*half_extents * 2.0)))
        }
        Shape::Capsule {
            half_height,
            radius,
        } => made::<CapsuleShape3D>(|capsule| {
            capsule.set_radius(*radius);
            capsule.set_height(2.0 * (half_height + radius));
        }),
        Shape::Cylinder {
            half_height,
            radius,
        } => made::<CylinderShape3D>(|cylinder| {
            cylinder.set_radius(*radius);
            cylinder.set_height(2.0 * half_height);
        }),
        Shape::Hull(hull) => made::<ConvexPolygonShape3D>(|convex| {
            convex.set_points(&hull.points().iter().map(|point| vector(*point)).collect());
        }),
        Shape::Mesh(mesh) => faces(mesh.points(), mesh.triangles()),
        Shape::Heights(heights) => {
            let posts: Vec<Vec3> = heights.posts().map(DVec3::as_vec3).collect();
            faces(&posts, &triangles(heights.rows(), heights.columns()))
        }
        Shape::HalfSpace { normal } => made::<WorldBoundaryShape3D>(|boundary| {
            boundary.set_plane(Plane::new(vector(*normal), 0.0));
        }),
        Shape::Compound(_) | Shape::RoundedCuboid { .. } | Shape::Cone { .. } => return None,
    })
}

fn cast<T: Inherits<Shape3D>>(resource: &Gd<Shape3D>) -> Option<Gd<T>> {
    resource.clone().try_cast().ok()
}

fn made<T>(set: impl FnOnce(&mut Gd<T>)) -> Gd<Shape3D>
where
    T: Inherits<Shape3D> + NewGd,
{
    let mut resource = T::new_gd();
    set(&mut resource);
    resource.upcast()
}

fn points(array: &PackedVector3Array) -> Vec<Vec3> {
    array.as_slice().iter().map(|point| vec3(*point)).collect()
}

/// A mesh of triangles, each given by its corners; equal corners become one point.
fn mesh_of(corners: &[Vec3]) -> Result<Mesh, Invalid> {
    let mut places = HashMap::new();
    let mut points = Vec::new();
    let mut place = |corner: Vec3| {
        // A zero has one sign, so that corners that are equal are one.
        let key = (corner + Vec3::ZERO).to_array().map(f32::to_bits);
        *places.entry(key).or_insert_with(|| {
            points.push(corner);
            points.len() as u32 - 1
        })
    };
    let triangles: Vec<[u32; 3]> = corners
        .chunks_exact(3)
        .map(|corners| [place(corners[0]), place(corners[1]), place(corners[2])])
        .collect();
    Mesh::new(&points, &triangles)
}

/// Godot's field has a post in each metre, stands around its middle, and goes along x first.
fn heights_of(field: &Gd<HeightMapShape3D>, edges: Edges) -> Result<NodeShape, DescriptionError> {
    let (width, depth) = (field.get_map_width(), field.get_map_depth());
    let data: PackedFloat32Array = field.get_map_data();
    let (columns, data) = (width as usize, data.as_slice());
    let by_x = (0..columns).flat_map(|x| data.iter().skip(x).step_by(columns).copied());
    let by_x: Vec<f32> = by_x.collect();
    let half = |posts: i32| -0.5 * (posts - 1) as f32;
    let heights = Heights::new(width as u32, 1.0, 1.0, &by_x)?;
    Ok(NodeShape {
        shape: Shape::Heights(heights.with_edges(edges)),
        origin: Vec3::new(half(width), 0.0, half(depth)),
    })
}

/// Two triangles for each cell of a grid of posts, row by row.
fn triangles(rows: u32, columns: u32) -> Vec<[u32; 3]> {
    let cells = (1..rows).flat_map(|row| (1..columns).map(move |column| (row, column)));
    let corners = |(row, column): (u32, u32)| {
        let post = |row: u32, column: u32| row * columns + column;
        let [a, b] = [post(row - 1, column - 1), post(row - 1, column)];
        let [c, d] = [post(row, column - 1), post(row, column)];
        [[a, b, c], [b, d, c]]
    };
    cells.flat_map(corners).collect()
}

fn faces(points: &[Vec3], triangles: &[[u32; 3]]) -> Gd<Shape3D> {
    let corners = triangles.iter().flatten();
    let corners: Vec<Vector3> = corners
        .map(|place| vector(points[*place as usize]))
        .collect();
    made::<ConcavePolygonShape3D>(|mesh| mesh.set_faces(&PackedVector3Array::from(corners)))
}
