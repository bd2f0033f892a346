//! Vectors and rotations between Godot's types and those of the client.
//!
//! Axes and units come from `rhumb-bindings`, the one place that has them for every engine. This file changes the types
//! alone.

use godot::builtin::{Quaternion, Vector3};
use rhumb_bindings::Coordinates;
use rhumb_client::glam::{Quat, Vec3};

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
