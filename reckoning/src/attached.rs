//! Motion of a body that is attached to another one.
//!
//! Normative (RECKONING 3.8). Which body is the parent of which is decided elsewhere.

use crate::exact::{add3, conjugate, cross3, normalised, product, turned};
use crate::motion::{Motion, Pose, Twist};

/// World motion of a body that is attached to `parent` at a pose in the parent's frame: it moves as a part of the
/// parent.
#[must_use]
pub fn attached_motion(parent: &Motion, attached: &Pose) -> Motion {
    let (pose, twist) = (parent.pose(), parent.twist());
    let arm = turned(pose.rotation, attached.position);
    let pose = Pose {
        position: add3(pose.position, arm),
        rotation: normalised(product(pose.rotation, attached.rotation)),
    };
    let twist = Twist {
        linear: add3(twist.linear, cross3(twist.angular, arm)),
        angular: twist.angular,
    };
    Motion::from_checked(pose, twist)
}

/// A world pose in the frame of its parent, without movement.
#[must_use]
pub fn relative_to(parent: &Pose, pose: &Pose) -> Motion {
    let back = conjugate(parent.rotation);
    let pose = Pose {
        position: turned(back, pose.position - parent.position),
        rotation: normalised(product(back, pose.rotation)),
    };
    Motion::from_checked(pose, Twist::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
        (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    fn pose() -> impl Strategy<Value = Pose> {
        (vector(1e3), vector(3.0)).prop_map(|(position, turn)| Pose {
            position,
            rotation: DQuat::from_scaled_axis(turn),
        })
    }

    proptest! {
        #[test]
        fn relative_to_inverts_motion_of_attached(
            parent in pose(), body in pose(), linear in vector(10.0), angular in vector(10.0),
        ) {
            let attached = relative_to(&parent, &body);
            let moving = Motion::new(parent, Twist { linear, angular }).unwrap();
            let again = attached_motion(&moving, &attached.pose());
            prop_assert!((again.pose().position - body.position).length() < 1e-9);
            prop_assert!(again.pose().rotation.dot(body.rotation).abs() > 1.0 - 1e-12);
            let expected = linear + angular.cross(body.position - parent.position);
            prop_assert!((again.twist().linear - expected).length() < 1e-8);
        }
    }
}
