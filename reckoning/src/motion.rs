//! A body's name, pose and velocity; attached bodies; the distance of poses.
//!
//! World frame, SI, right-handed; rotations are unit quaternions body → world; velocities are those of the centre of
//! mass. Invariant: a [`Motion`] is finite and its rotation is of unit length. Attachment is normative (RECKONING 3.8).
//! `tolerance` decides whether a distance matters; the properties of a body are the protocol's `BodyDesc`.
//!
//! For display only, and never normative, a correction smooths a jump of a displayed body into a short glide. It is a
//! function of time: the whole jump at its start and zero after [`Correction::SPAN`]. Its velocity is the derivative of the
//! displayed offset.

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

/// Offset that is still to be taken off a displayed motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    start: Seconds,
    offset: DVec3,
    offset_velocity: DVec3,
    turn: DVec3,
}

impl Correction {
    /// Duration of a glide.
    pub const SPAN: Seconds = Seconds::new(0.1);
    /// A jump longer than this is shown at once: it is a teleport, not an error.
    pub const TELEPORT: Metres = Metres::new(2.0);

    /// A correction of zero.
    pub const NONE: Self = Self {
        start: Seconds::new(f64::NEG_INFINITY),
        offset: DVec3::ZERO,
        offset_velocity: DVec3::ZERO,
        turn: DVec3::ZERO,
    };

    /// The correction that leads from `shown` to `predicted_motion` from `now` on, without a jump in position or
    /// velocity.
    #[must_use]
    pub fn between(now: Seconds, shown: &Motion, predicted_motion: &Motion) -> Self {
        let offset = shown.pose().position - predicted_motion.pose().position;
        if offset.length() > Self::TELEPORT.metres() {
            return Self::NONE;
        }
        let quotient = shown.pose().rotation * predicted_motion.pose().rotation.conjugate();
        let quotient = if quotient.w < 0.0 {
            -quotient
        } else {
            quotient
        };
        Self {
            start: now,
            offset,
            offset_velocity: shown.twist().linear - predicted_motion.twist().linear,
            turn: quotient.to_scaled_axis(),
        }
    }

    /// The motion to display at `now`, where the prediction is `predicted_motion`.
    #[must_use]
    pub fn applied(&self, now: Seconds, predicted_motion: &Motion) -> Motion {
        let span = Self::SPAN.seconds();
        let s = (now.seconds() - self.start.seconds()) / span;
        // Written so that NaN counts as over.
        let under_way = (0.0..1.0).contains(&s);
        if !under_way {
            return *predicted_motion;
        }
        // Cubic Hermite from (offset, velocity) to (0, 0); `h` weighs the offset, `k` the velocity times the span.
        let h = (1.0 + 2.0 * s) * (1.0 - s) * (1.0 - s);
        let k = s * (1.0 - s) * (1.0 - s);
        let dh = 6.0 * s * (s - 1.0) / span;
        let dk = (1.0 - s) * (1.0 - 3.0 * s);
        let (pose, twist) = (predicted_motion.pose(), predicted_motion.twist());
        let shown = Pose {
            position: pose.position + self.offset * h + self.offset_velocity * (k * span),
            rotation: (turn_by(self.turn * h) * pose.rotation).normalize(),
        };
        let moving = Twist {
            linear: twist.linear + self.offset * dh + self.offset_velocity * dk,
            angular: twist.angular + self.turn * dh,
        };
        Motion::new(shown, moving).unwrap_or(*predicted_motion)
    }

    /// True if the glide has ended.
    #[must_use]
    pub fn is_over(&self, now: Seconds) -> bool {
        let left = now.seconds() - self.start.seconds() < Self::SPAN.seconds();
        !left
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

    fn motion() -> impl Strategy<Value = Motion> {
        let part = || proptest::array::uniform3(-0.5_f64..0.5).prop_map(DVec3::from_array);
        (part(), part(), part(), part()).prop_map(|(position, turn, linear, angular)| {
            let rotation = DQuat::from_scaled_axis(turn);
            Motion::new(Pose { position, rotation }, Twist { linear, angular }).unwrap()
        })
    }

    proptest! {
        #[test]
        fn a_correction_starts_at_the_displayed_motion(shown in motion(), predicted_motion in motion()) {
            let now = Seconds::new(7.0);
            let first = Correction::between(now, &shown, &predicted_motion).applied(now, &predicted_motion);
            prop_assert!((first.pose().position - shown.pose().position).length() < 1e-9);
            prop_assert!((first.twist().linear - shown.twist().linear).length() < 1e-9);
            prop_assert!(first.pose().rotation.angle_between(shown.pose().rotation) < 1e-6);
        }

        #[test]
        fn a_correction_is_zero_after_its_span(shown in motion(), predicted_motion in motion()) {
            let correction = Correction::between(Seconds::new(7.0), &shown, &predicted_motion);
            let late = Seconds::new(7.0 + Correction::SPAN.seconds() + 1e-9);
            prop_assert_eq!(correction.applied(late, &predicted_motion), predicted_motion);
            prop_assert!(correction.is_over(Seconds::new(8.0)));
        }

        #[test]
        fn its_velocity_is_the_derivative_of_its_offset(
            shown in motion(), predicted_motion in motion(), s in 0.01_f64..0.09,
        ) {
            let still = predicted_motion.stilled();
            let correction = Correction::between(Seconds::new(0.0), &shown, &still);
            let step = 1e-6;
            let before = correction.applied(Seconds::new(s - step), &still).pose().position;
            let after = correction.applied(Seconds::new(s + step), &still).pose().position;
            let shown_velocity = correction.applied(Seconds::new(s), &still).twist().linear;
            prop_assert!(((after - before) / (2.0 * step) - shown_velocity).length() < 1e-4);
        }
    }

    #[test]
    fn a_teleport_does_not_glide() {
        let far = Pose {
            position: DVec3::X * 10.0,
            rotation: DQuat::IDENTITY,
        };
        let far = Motion::new(far, Twist::ZERO).unwrap();
        assert_eq!(
            Correction::between(Seconds::new(1.0), &far, &Motion::IDENTITY),
            Correction::NONE
        );
    }
}
