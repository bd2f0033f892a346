//! Checks of the numbers in commands, and their errors.
//!
//! The client checks before sending and the server after receiving, with the same code: both give the same answer.

use core::fmt;

use glam::{Quat, Vec3};
use rhumb_reckoning::{InvalidMotion, UNIT_LENGTH_SLACK};

/// A quantity of a command that can be invalid. Its number is its code on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Quantity {
    /// Metres.
    Position = 0,
    /// Unit quaternion.
    Rotation = 1,
    /// m/s.
    Linear = 2,
    /// rad/s.
    Angular = 3,
    /// N.
    Force = 4,
    /// N·m.
    Torque = 5,
    /// N·s.
    Impulse = 6,
    /// N·m·s.
    TorqueImpulse = 7,
    /// m/s².
    Gravity = 8,
    /// Metres.
    Extent = 9,
    /// kg/m³.
    Density = 10,
    /// Coefficient.
    Friction = 11,
    /// Coefficient.
    Restitution = 12,
    /// 1/s.
    Damping = 13,
    /// Factor.
    GravityScale = 14,
    /// Steps.
    Substeps = 15,
    /// Ticks per second.
    Rate = 16,
    /// Number of a hull's points.
    HullPoints = 17,
    /// Metres.
    HullThickness = 18,
    /// Metres.
    Anchor = 19,
    /// Radians or metres.
    JointLimit = 20,
    /// m/s.
    SleepSpeed = 21,
    /// Seconds.
    SleepSeconds = 22,
    /// Ticks from one publication to the next.
    PublishInterval = 23,
    /// Ticks.
    Lookahead = 24,
    /// Publication times of a lockstep scene.
    LockstepPublishing = 25,
    /// Rows and columns of heights, and their product.
    Posts = 26,
    /// Number of a mesh's points.
    MeshPoints = 27,
    /// Number of a mesh's triangles.
    Triangles = 28,
    /// Point index of a triangle.
    TrianglePoint = 29,
    /// Number of a compound's parts, and their kind.
    Parts = 30,
    /// kg.
    Mass = 31,
    /// kg·m².
    Moments = 32,
    /// Motor of a joint.
    Motor = 33,
    /// Spring of a joint.
    Spring = 34,
    /// Force or torque at which a joint breaks, N or N·m.
    Strength = 35,
    /// Setting of a character: metres, radians or kg.
    Character = 36,
    /// Setting or input of a vehicle's wheel.
    Wheel = 37,
    /// Number of a vehicle's wheels.
    Wheels = 38,
}

impl Quantity {
    const ALL: [Self; 39] = [
        Self::Position,
        Self::Rotation,
        Self::Linear,
        Self::Angular,
        Self::Force,
        Self::Torque,
        Self::Impulse,
        Self::TorqueImpulse,
        Self::Gravity,
        Self::Extent,
        Self::Density,
        Self::Friction,
        Self::Restitution,
        Self::Damping,
        Self::GravityScale,
        Self::Substeps,
        Self::Rate,
        Self::HullPoints,
        Self::HullThickness,
        Self::Anchor,
        Self::JointLimit,
        Self::SleepSpeed,
        Self::SleepSeconds,
        Self::PublishInterval,
        Self::Lookahead,
        Self::LockstepPublishing,
        Self::Posts,
        Self::MeshPoints,
        Self::Triangles,
        Self::TrianglePoint,
        Self::Parts,
        Self::Mass,
        Self::Moments,
        Self::Motor,
        Self::Spring,
        Self::Strength,
        Self::Character,
        Self::Wheel,
        Self::Wheels,
    ];

    /// The quantity of a code.
    #[must_use]
    pub fn from_code(code: u8) -> Option<Self> {
        Self::ALL.get(usize::from(code)).copied()
    }

    /// Its code.
    #[must_use]
    pub const fn code(self) -> u8 {
        self as u8
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Rotation => "rotation",
            Self::Linear => "linear velocity",
            Self::Angular => "angular velocity",
            Self::Force => "force",
            Self::Torque => "torque",
            Self::Impulse => "impulse",
            Self::TorqueImpulse => "torque impulse",
            Self::Gravity => "gravity",
            Self::Extent => "shape extent",
            Self::Density => "density",
            Self::Friction => "friction",
            Self::Restitution => "restitution",
            Self::Damping => "damping",
            Self::GravityScale => "gravity scale",
            Self::Substeps => "number of substeps",
            Self::Rate => "tick rate",
            Self::HullPoints => "number of a hull's points",
            Self::HullThickness => "thickness of a hull",
            Self::Anchor => "anchor of a joint",
            Self::JointLimit => "limit of a joint",
            Self::SleepSpeed => "speed below which bodies sleep",
            Self::SleepSeconds => "time until bodies sleep",
            Self::PublishInterval => "number of ticks from one publication to the next",
            Self::Lookahead => "lookahead",
            Self::LockstepPublishing => "publication time of a lockstep scene",
            Self::Posts => "number of rows and columns of heights",
            Self::MeshPoints => "number of a mesh's points",
            Self::Triangles => "number of a mesh's triangles",
            Self::TrianglePoint => "point of a triangle",
            Self::Parts => "parts of a compound",
            Self::Mass => "mass",
            Self::Moments => "moments of inertia",
            Self::Motor => "motor of a joint",
            Self::Spring => "spring of a joint",
            Self::Strength => "strength of a joint",
            Self::Character => "setting of a character",
            Self::Wheel => "wheel of a vehicle",
            Self::Wheels => "number of a vehicle's wheels",
        })
    }
}

/// A number that is not allowed in a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Invalid {
    /// NaN or infinite.
    NotFinite(Quantity),
    /// Outside the limits of the protocol.
    OutOfRange(Quantity),
}

impl From<InvalidMotion> for Invalid {
    fn from(invalid: InvalidMotion) -> Self {
        Self::NotFinite(match invalid {
            InvalidMotion::Position => Quantity::Position,
            InvalidMotion::Rotation => Quantity::Rotation,
            InvalidMotion::Linear => Quantity::Linear,
            InvalidMotion::Angular => Quantity::Angular,
        })
    }
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite(Quantity::Rotation) => {
                f.write_str("rotation is not a finite quaternion of unit length")
            }
            Self::NotFinite(quantity) => write!(f, "{quantity} is NaN or infinite"),
            Self::OutOfRange(Quantity::LockstepPublishing) => f.write_str(
                "a lockstep scene publishes its ticks at once: make it free-running to publish with lookahead",
            ),
            Self::OutOfRange(quantity) => write!(f, "{quantity} is outside its limits"),
        }
    }
}

impl core::error::Error for Invalid {}

/// Checks a number against inclusive bounds.
pub(super) fn scalar(value: f32, least: f32, most: f32, quantity: Quantity) -> Result<(), Invalid> {
    if !value.is_finite() {
        return Err(Invalid::NotFinite(quantity));
    }
    if value < least || value > most {
        return Err(Invalid::OutOfRange(quantity));
    }
    Ok(())
}

/// Checks that each component of a vector is at most `most` in size.
pub(super) fn vector(value: Vec3, most: f32, quantity: Quantity) -> Result<(), Invalid> {
    for part in value.to_array() {
        scalar(part, -most, most, quantity)?;
    }
    Ok(())
}

/// A direction of unit length, by the rule for rotations.
pub(super) fn direction(value: Vec3) -> Result<(), Invalid> {
    rotation(Quat::from_vec4(value.extend(0.0)))
}

/// A quaternion of unit length, by the rule for body states (RECKONING 1.6).
pub(super) fn rotation(value: Quat) -> Result<(), Invalid> {
    let squared: f64 = value
        .to_array()
        .iter()
        .map(|&c| f64::from(c) * f64::from(c))
        .sum();
    let near_unit = (libm::sqrt(squared) - 1.0).abs() <= UNIT_LENGTH_SLACK;
    if near_unit {
        Ok(())
    } else {
        Err(Invalid::NotFinite(Quantity::Rotation))
    }
}
