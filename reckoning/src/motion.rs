//! Pose and velocity of a body.
//!
//! World frame, SI, right-handed; rotations are unit quaternions body → world; velocities are those of the centre of
//! mass. Invariant: a [`Motion`] is finite and its rotation is of unit length.

use core::fmt;

use glam::{DQuat, DVec3};

use crate::exact;

/// Position of the centre of mass (m) and rotation body → world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Centre of mass, metres, world frame.
    pub position: DVec3,
    /// Unit quaternion, body → world.
    pub rotation: DQuat,
}

impl Pose {
    /// At the origin, unturned.
    pub const IDENTITY: Self = Self {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };
}

/// Velocity of the centre of mass (m/s) and angular velocity (rad/s), both along world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Metres per second, world frame.
    pub linear: DVec3,
    /// Radians per second about world axes.
    pub angular: DVec3,
}

impl Twist {
    /// No motion.
    pub const ZERO: Self = Self {
        linear: DVec3::ZERO,
        angular: DVec3::ZERO,
    };
}

/// A checked pose and twist: finite, with a rotation of unit length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    pose: Pose,
    twist: Twist,
}

/// The distance that a rotation may have from unit length to count as rounded; beyond, it is invalid.
///
/// Ten thousand times what f32 arithmetic loses in one product, and far below any mistake.
pub const UNIT_LENGTH_SLACK: f64 = 1e-3;

impl Motion {
    /// Still, at the origin.
    pub const IDENTITY: Self = Self {
        pose: Pose::IDENTITY,
        twist: Twist::ZERO,
    };

    /// Checks a pose and twist; a rotation within [`UNIT_LENGTH_SLACK`] of unit length is normalised.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`] names the part that is not finite, or a rotation that is not of unit length.
    pub fn new(pose: Pose, twist: Twist) -> Result<Self, InvalidMotion> {
        if !pose.position.is_finite() {
            return Err(InvalidMotion::Position);
        }
        if !twist.linear.is_finite() {
            return Err(InvalidMotion::Linear);
        }
        if !twist.angular.is_finite() {
            return Err(InvalidMotion::Angular);
        }
        let length = exact::length4(pose.rotation);
        // Written so that NaN fails too.
        let near_unit = (length - 1.0).abs() <= UNIT_LENGTH_SLACK;
        if !near_unit {
            return Err(InvalidMotion::Rotation);
        }
        let rotation = exact::normalised(pose.rotation);
        Ok(Self {
            pose: Pose { rotation, ..pose },
            twist,
        })
    }

    /// For results of normative arithmetic, whose inputs were checked and whose rotation was just normalised.
    pub(crate) const fn from_checked(pose: Pose, twist: Twist) -> Self {
        Self { pose, twist }
    }

    /// Position and rotation.
    #[must_use]
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// Linear and angular velocity.
    #[must_use]
    pub const fn twist(&self) -> Twist {
        self.twist
    }

    /// Position, rotation (x, y, z, w), linear and angular velocity, as numbers.
    #[must_use]
    pub fn parts(&self) -> [f64; 13] {
        let Pose { position, rotation } = self.pose;
        let Twist { linear, angular } = self.twist;
        let [x, y, z, w] = rotation.to_array();
        [
            position.x, position.y, position.z, x, y, z, w, linear.x, linear.y, linear.z,
            angular.x, angular.y, angular.z,
        ]
    }

    /// The same pose with these velocities, or without movement where they are not finite.
    #[must_use]
    pub fn moving(&self, twist: Twist) -> Self {
        let finite = twist.linear.is_finite() && twist.angular.is_finite();
        Self {
            pose: self.pose,
            twist: if finite { twist } else { Twist::ZERO },
        }
    }

    /// The same pose without movement.
    #[must_use]
    pub const fn stilled(&self) -> Self {
        Self {
            pose: self.pose,
            twist: Twist::ZERO,
        }
    }
}

/// The part of a motion that is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InvalidMotion {
    /// A coordinate is NaN or infinite.
    Position,
    /// The quaternion is not finite or not of unit length.
    Rotation,
    /// A linear velocity is NaN or infinite.
    Linear,
    /// An angular velocity is NaN or infinite.
    Angular,
}

impl fmt::Display for InvalidMotion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position is not finite",
            Self::Rotation => "rotation is not a finite quaternion of unit length",
            Self::Linear => "linear velocity is not finite",
            Self::Angular => "angular velocity is not finite",
        })
    }
}

impl core::error::Error for InvalidMotion {}
