//! A body's name, pose and velocity; attached bodies; the distance of poses.
//!
//! World frame, SI, right-handed; rotations are unit quaternions body → world; velocities are those of the centre of
//! mass. Invariant: a [`Motion`] is finite and its rotation is of unit length. Attachment is normative (RECKONING 3.8).
//! Whether a distance matters is decided in `tolerance`; the properties of a body are the protocol's `BodyDesc`.

use core::fmt;

use glam::{DQuat, DVec3};

use crate::exact::{
    add3, conjugate, cross3, length3, length4, normalised, product, sqrt, turn_by, turned,
};
use crate::units::{Metres, Radians, Seconds};

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

    /// The turn by the angular velocity in a time, about the world's axes.
    #[must_use]
    pub fn turn_over(&self, time: Seconds) -> DQuat {
        turn_by(self.angular * time.seconds())
    }
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
        let length = length4(pose.rotation);
        // Written so that NaN fails too.
        let near_unit = (length - 1.0).abs() <= UNIT_LENGTH_SLACK;
        if !near_unit {
            return Err(InvalidMotion::Rotation);
        }
        if !twist.linear.is_finite() {
            return Err(InvalidMotion::Linear);
        }
        if !twist.angular.is_finite() {
            return Err(InvalidMotion::Angular);
        }
        let rotation = normalised(pose.rotation);
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

/// Names one body of one scene for all of the body's life, and no other body before or after it.
///
/// An index may be used again after its body was removed; the generation then grows by one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BodyId {
    index: u32,
    generation: u16,
    spare: Spare,
}

impl BodyId {
    /// The `generation`-th body to use `index`.
    #[must_use]
    pub const fn new(index: u32, generation: u16) -> Self {
        Self {
            index,
            generation,
            spare: Spare::Nothing,
        }
    }

    /// Place in dense arrays.
    #[must_use]
    pub const fn index(self) -> u32 {
        self.index
    }

    /// The number of bodies that used this index before.
    #[must_use]
    pub const fn generation(self) -> u16 {
        self.generation
    }
}

/// A byte with one value: an `Option` or `enum` around its type uses the other values and needs no byte of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub(crate) enum Spare {
    #[default]
    Nothing,
}

impl fmt::Display for BodyId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "body {}.{}", self.index, self.generation)
    }
}

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

/// Distance between two poses of one body at one tick.
///
/// `position`: between centres of mass, world frame, ≥ 0. `half_chord`: sine of half the shortest turn, in [0, 1]; zero
/// exactly when the rotations agree up to the sign of the quaternion. Source: RECKONING 5.1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Divergence {
    /// Between centres of mass.
    pub position: Metres,
    /// Sine of half the shortest turn.
    pub half_chord: f64,
}

impl Divergence {
    /// Distance between a true and a predicted pose.
    #[must_use]
    pub fn between(truth: &Pose, prediction: &Pose) -> Self {
        let apart = length3(truth.position - prediction.position);
        // q and -q are one rotation, and the vector part of their quotient has one length.
        let turn = product(truth.rotation, conjugate(prediction.rotation));
        let half_chord = sqrt(turn.x * turn.x + turn.y * turn.y + turn.z * turn.z).min(1.0);
        Self {
            position: Metres::new(apart),
            half_chord,
        }
    }

    /// Bound on the distance between any point of the body and its prediction: |Δp| + 2 r sin(Δθ/2).
    #[must_use]
    pub fn surface_error(&self, radius: Metres) -> Metres {
        Metres::new(self.position.metres() + 2.0 * radius.metres() * self.half_chord)
    }

    /// The shortest turn, in [0, π].
    #[must_use]
    pub fn turn(&self) -> Radians {
        Radians::new(2.0 * libm::asin(self.half_chord))
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};
    use proptest::prelude::*;

    use super::*;

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

    #[test]
    fn the_first_fault_in_the_order_of_the_parts_is_named() {
        let none = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.5);
        let (zero, nan) = (DVec3::ZERO, DVec3::new(0.0, f64::NAN, 0.0));
        for (position, rotation, linear, angular, fault) in [
            (nan, none, nan, nan, InvalidMotion::Position),
            (zero, none, nan, nan, InvalidMotion::Rotation),
            (zero, DQuat::IDENTITY, nan, nan, InvalidMotion::Linear),
            (zero, DQuat::IDENTITY, zero, nan, InvalidMotion::Angular),
        ] {
            let pose = Pose { position, rotation };
            assert_eq!(Motion::new(pose, Twist { linear, angular }), Err(fault));
        }
    }

    #[test]
    fn opposite_quaternions_are_one_rotation() {
        let rotation = DQuat::from_rotation_y(0.7);
        let here = Pose {
            position: DVec3::ZERO,
            rotation,
        };
        let same = Pose {
            position: DVec3::ZERO,
            rotation: -rotation,
        };
        assert!(Divergence::between(&here, &same).half_chord < 1e-15);
    }

    #[test]
    fn surface_error_adds_the_chord_at_the_bounding_radius() {
        let truth = Pose {
            position: DVec3::X * 3.0,
            rotation: DQuat::from_rotation_z(0.2),
        };
        let far = Divergence::between(&truth, &Pose::IDENTITY);
        let expected = 3.0 + 2.0 * 0.5 * libm::sin(0.1);
        assert!((far.surface_error(Metres::new(0.5)).metres() - expected).abs() < 1e-12);
        assert!((far.turn().radians() - 0.2).abs() < 1e-12);
    }
}
