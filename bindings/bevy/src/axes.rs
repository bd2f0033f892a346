//! Vectors and rotations between Bevy's types and those of the client.
//!
//! Axes and units come from `rhumb-bindings`, the one place that has them for every engine. This file changes the types
//! alone: Bevy's maths and the client's are two versions of one crate.

use bevy_math::{Quat, Vec3};
use rhumb_bindings::Coordinates;
use rhumb_client::glam;

/// The coordinates of Bevy.
pub(crate) const AXES: Coordinates = Coordinates::BEVY;

/// A position, velocity, force or impulse of Bevy, for the client.
pub(crate) fn vector_in(vector: Vec3) -> glam::Vec3 {
    AXES.vector_in(glam::Vec3::from_array(vector.to_array()))
}

/// A torque or angular impulse of Bevy, for the client.
pub(crate) fn torque_in(torque: Vec3) -> glam::Vec3 {
    AXES.torque_in(glam::Vec3::from_array(torque.to_array()))
}

/// An angular velocity of Bevy, for the client.
pub(crate) fn angular_in(angular: Vec3) -> glam::Vec3 {
    AXES.angular_in(glam::Vec3::from_array(angular.to_array()))
}

/// A rotation of Bevy, for the client.
pub(crate) fn rotation_in(rotation: Quat) -> glam::Quat {
    AXES.rotation_in(glam::Quat::from_array(rotation.to_array()))
}

/// A vector in Bevy's axes.
pub(crate) fn vector(vector: glam::Vec3) -> Vec3 {
    Vec3::from_array(vector.to_array())
}

/// A rotation in Bevy's axes.
pub(crate) fn rotation(rotation: glam::Quat) -> Quat {
    Quat::from_array(rotation.to_array())
}

#[cfg(test)]
mod tests {
    use bevy_transform::components::Transform;

    use super::*;

    #[test]
    fn up_in_bevy_is_up_in_rhumb_and_a_metre_is_a_metre() {
        let up = Transform::IDENTITY.up() * 2.0;
        assert_eq!(vector_in(up), glam::Vec3::Y * 2.0);
        assert_eq!(vector(AXES.vector_out(glam::Vec3::Y * 2.0)), up);
    }

    #[test]
    fn bevys_axes_are_as_handed_as_the_conversion_says() {
        let at = Transform::IDENTITY;
        let is_right_handed = at.right().cross(*at.up()).dot(*at.back()) > 0.0;
        assert_ne!(is_right_handed, AXES.is_left_handed());
    }

    #[test]
    fn a_turn_takes_a_vector_to_the_same_place_in_both() {
        let (turn, arm) = (
            Quat::from_euler(bevy_math::EulerRot::YXZ, 0.3, -0.8, 1.9),
            Vec3::new(1.0, 2.0, 3.0),
        );
        let inside = rotation_in(turn) * vector_in(arm);
        assert!(vector(AXES.vector_out(inside)).distance(turn * arm) < 1e-5);
        assert_eq!(rotation(AXES.rotation_out(rotation_in(turn))), turn);
    }

    #[test]
    fn a_spin_and_a_torque_come_back_as_they_were() {
        let spin = Vec3::new(0.5, -2.0, 7.0);
        assert_eq!(vector(AXES.angular_out(angular_in(spin))), spin);
        // Metres and kilograms: a torque has the same number inside.
        assert_eq!(torque_in(spin), angular_in(spin));
    }
}
