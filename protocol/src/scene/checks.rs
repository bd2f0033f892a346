//! Checks of the numbers in commands, and their errors.
//!
//! The client checks before sending and the server after receiving, with the same code: both give the same answer.

use core::fmt;
use core::hash::{Hash, Hasher};

use glam::{Quat, Vec3};
use rhumb_reckoning::{InvalidMotion, UNIT_LENGTH_SLACK};

use crate::limits::{
    ANGULAR_MAX, COORDINATE_MAX, DAMPING_MAX, DENSITY_MAX, DENSITY_MIN, EXTENT_MAX, EXTENT_MIN,
    FORCE_MAX, FRICTION_MAX, GRAVITY_MAX, GRAVITY_SCALE_MAX, GYRATION_MAX, GYRATION_MIN,
    HULL_FLATNESS, HULL_POINTS_MAX, HULL_POINTS_MIN, LINEAR_MAX, LOOKAHEAD_TICKS_MAX, MASS_MAX,
    MASS_MIN, MESH_POINTS_MAX, MOMENT_MAX, PARTS_BYTES_MAX, PARTS_MAX, POSTS_MAX,
    PUBLISH_SECONDS_MAX, RATE_MAX, SLEEP_SECONDS_MAX, SLEEP_SPEED_MAX, SUBSTEPS_MAX, TRIANGLES_MAX,
    WHEELS_MAX,
};

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
    /// rad/s.
    SleepAngularSpeed = 39,
}

impl Quantity {
    const ALL: [Self; 40] = [
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
        Self::SleepAngularSpeed,
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

    /// Its unit; empty where it has none, or several.
    const fn unit(self) -> &'static str {
        match self {
            Self::Position | Self::Extent | Self::HullThickness | Self::Anchor => "m",
            Self::Linear | Self::SleepSpeed => "m/s",
            Self::Angular | Self::SleepAngularSpeed => "rad/s",
            Self::Force => "N",
            Self::Torque => "N·m",
            Self::Impulse => "N·s",
            Self::TorqueImpulse => "N·m·s",
            Self::Gravity => "m/s²",
            Self::Density => "kg/m³",
            Self::Damping => "1/s",
            Self::Rate => "a second",
            Self::SleepSeconds => "s",
            Self::PublishInterval | Self::Lookahead => "ticks",
            Self::Mass => "kg",
            Self::Moments => "kg·m²",
            _ => "",
        }
    }

    /// The rule for a quantity whose numbers have several limits.
    fn write_rule(self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self} is outside its limits: ")?;
        match self {
            Self::Rate => write!(
                f,
                "1 to {RATE_MAX} ticks a second, and no more than the server allows"
            ),
            Self::HullThickness => write!(
                f,
                "at least {EXTENT_MIN} m, and {HULL_FLATNESS} of the hull's radius"
            ),
            Self::PublishInterval => write!(f, "at most {PUBLISH_SECONDS_MAX} s"),
            Self::LockstepPublishing => f.write_str(LOOKAHEAD_IN_LOCKSTEP),
            Self::Posts => write!(
                f,
                "at least 2 rows and 2 columns, and at most {POSTS_MAX} heights"
            ),
            Self::TrianglePoint => f.write_str("each names one of the mesh's points"),
            Self::Parts => write!(
                f,
                "at most {PARTS_MAX} of {PARTS_BYTES_MAX} bytes, and no compound among them"
            ),
            Self::Moments => write!(
                f,
                "those of a shape are at most {MOMENT_MAX:e} kg·m², a body's own {GYRATION_MIN:e} to {GYRATION_MAX:e} m² for each kilogram, none above the sum of the other two"
            ),
            Self::JointLimit => write!(
                f,
                "of an axis that the joint leaves free, a distance of at most {EXTENT_MAX} m, or angles from -2 pi to 2 pi, at most a whole turn apart"
            ),
            Self::Motor => write!(
                f,
                "of an axis that the joint leaves free, a distance of at most {EXTENT_MAX} m or an angle from -pi to pi"
            ),
            _ => f.write_str("section 7 of spec/PROTOCOL.md has them"),
        }
    }

    /// Its limits, if all numbers of the quantity have the same.
    fn limits(self) -> Option<NumberRange> {
        let (least, most) = match self {
            Self::Position => (-COORDINATE_MAX, COORDINATE_MAX),
            Self::Linear => (-LINEAR_MAX, LINEAR_MAX),
            Self::Angular => (-ANGULAR_MAX, ANGULAR_MAX),
            Self::Force | Self::Torque | Self::Impulse | Self::TorqueImpulse => {
                (-FORCE_MAX, FORCE_MAX)
            }
            Self::Gravity => (-GRAVITY_MAX, GRAVITY_MAX),
            Self::Extent => (EXTENT_MIN, EXTENT_MAX),
            Self::Anchor => (-EXTENT_MAX, EXTENT_MAX),
            Self::Density => (DENSITY_MIN, DENSITY_MAX),
            Self::Friction => (0.0, FRICTION_MAX),
            Self::Restitution => (0.0, 1.0),
            Self::Damping => (0.0, DAMPING_MAX),
            Self::GravityScale => (-GRAVITY_SCALE_MAX, GRAVITY_SCALE_MAX),
            Self::Substeps => (1.0, SUBSTEPS_MAX as f32),
            Self::HullPoints => (HULL_POINTS_MIN as f32, HULL_POINTS_MAX as f32),
            Self::SleepSpeed => (0.0, SLEEP_SPEED_MAX),
            Self::SleepAngularSpeed => (0.0, ANGULAR_MAX),
            Self::SleepSeconds => (0.0, SLEEP_SECONDS_MAX),
            Self::Lookahead => (0.0, LOOKAHEAD_TICKS_MAX as f32),
            Self::MeshPoints => (3.0, MESH_POINTS_MAX as f32),
            Self::Triangles => (1.0, TRIANGLES_MAX as f32),
            Self::Mass => (MASS_MIN, MASS_MAX),
            Self::Wheels => (1.0, WHEELS_MAX as f32),
            _ => return None,
        };
        let [least, most] = [least, most].map(f64::from);
        let unit = self.unit();
        Some(NumberRange { least, most, unit })
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
            Self::SleepAngularSpeed => "angular speed below which bodies sleep",
        })
    }
}

/// A number that is not allowed in a command: its quantity, and the rule that it breaks.
///
/// Two are equal if quantity and rule are: only these cross the wire. The check that finds it also keeps what
/// was found, for the sentence.
#[derive(Clone, Copy, Debug)]
pub struct Invalid {
    /// The rule that the number breaks.
    pub rule: Rule,
    /// The quantity that the number measures.
    pub quantity: Quantity,
    found: Found,
}

/// A rule that a number of a command breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Rule {
    /// It is NaN or infinite; of a rotation or a direction: it is not of unit length.
    NotFinite,
    /// It is outside the limits of the protocol.
    OutOfRange,
}

/// The invalid value, as its check found it.
#[derive(Clone, Copy, Debug)]
enum Found {
    /// Another machine found it.
    Elsewhere,
    /// A number, with its inclusive limits.
    Number {
        name: Option<&'static str>,
        unit: &'static str,
        value: f64,
        least: f64,
        most: f64,
        advice: Option<&'static str>,
    },
    /// The length of a quaternion or direction.
    Length { name: &'static str, length: f64 },
    /// An axis of a joint that is locked: translations along x, y and z, then rotations about x, y and z.
    LockedAxis(usize),
    /// A sentence says it.
    Sentence(&'static str),
}

impl Invalid {
    /// A number that is NaN or infinite, or a rotation that is not of unit length, as another machine found it.
    #[must_use]
    pub const fn not_finite(quantity: Quantity) -> Self {
        Self {
            rule: Rule::NotFinite,
            quantity,
            found: Found::Elsewhere,
        }
    }

    /// A number outside its limits, as another machine found it.
    #[must_use]
    pub const fn out_of_range(quantity: Quantity) -> Self {
        Self {
            rule: Rule::OutOfRange,
            quantity,
            found: Found::Elsewhere,
        }
    }

    /// The predicate of a sentence whose subject is the quantity.
    pub(crate) const fn because(quantity: Quantity, sentence: &'static str) -> Self {
        Self {
            rule: Rule::OutOfRange,
            quantity,
            found: Found::Sentence(sentence),
        }
    }

    /// A limit or motor of an axis that the joint locks.
    pub(super) const fn of_axis(quantity: Quantity, axis: usize) -> Self {
        Self {
            rule: Rule::OutOfRange,
            quantity,
            found: Found::LockedAxis(axis),
        }
    }

    /// Names the number more closely than its quantity does.
    pub(super) const fn of(mut self, part: &'static str, unit_of_part: &'static str) -> Self {
        match &mut self.found {
            Found::Number { name, unit, .. } => {
                *name = Some(part);
                *unit = unit_of_part;
            }
            Found::Length { name, .. } => *name = part,
            Found::Elsewhere | Found::LockedAxis(_) | Found::Sentence(_) => {}
        }
        self
    }

    /// Adds what helps against a number above its limit.
    pub(super) fn advised(mut self, sentence: &'static str) -> Self {
        if let Found::Number {
            value,
            most,
            advice,
            ..
        } = &mut self.found
            && *value > *most
        {
            *advice = Some(sentence);
        }
        self
    }
}

impl PartialEq for Invalid {
    fn eq(&self, other: &Self) -> bool {
        (self.rule, self.quantity) == (other.rule, other.quantity)
    }
}

impl Eq for Invalid {}

impl Hash for Invalid {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (self.rule, self.quantity).hash(state);
    }
}

impl From<InvalidMotion> for Invalid {
    fn from(invalid: InvalidMotion) -> Self {
        Self::not_finite(match invalid {
            InvalidMotion::Position => Quantity::Position,
            InvalidMotion::Rotation => Quantity::Rotation,
            InvalidMotion::Linear => Quantity::Linear,
            InvalidMotion::Angular => Quantity::Angular,
        })
    }
}

impl fmt::Display for Invalid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let quantity = self.quantity;
        match self.found {
            Found::Number {
                name,
                unit,
                value,
                least,
                most,
                advice,
            } => {
                match name {
                    Some(name) => f.write_str(name)?,
                    None => quantity.fmt(f)?,
                }
                let limits = NumberRange { least, most, unit };
                write!(f, " is {}, and must be {limits}", Measured(value, unit))?;
                advice.map_or(Ok(()), |advice| write!(f, ": {advice}"))
            }
            Found::Length { name, length } => write!(
                f,
                "{name} has the length {}, and must be of unit length",
                Measured(length, "")
            ),
            Found::LockedAxis(axis) => {
                let motion = if axis < 3 {
                    "translation along"
                } else {
                    "rotation about"
                };
                let direction = ["x", "y", "z"][axis % 3];
                let what = if quantity == Quantity::Motor {
                    "motor"
                } else {
                    "limit"
                };
                write!(
                    f,
                    "{what} of axis {axis}, the {motion} {direction}: the joint locks this axis, and only a free one can have one"
                )
            }
            Found::Sentence(sentence) => write!(f, "{quantity}: {sentence}"),
            Found::Elsewhere => match (self.rule, quantity) {
                (Rule::NotFinite, Quantity::Rotation) => {
                    f.write_str("rotation is not a finite quaternion of unit length")
                }
                (Rule::NotFinite, _) => write!(f, "{quantity} is NaN or infinite"),
                (Rule::OutOfRange, _) => match quantity.limits() {
                    // A server finds it when a push would make a body too fast.
                    Some(limits) if matches!(quantity, Quantity::Linear | Quantity::Angular) => {
                        write!(f, "{quantity} would be outside its limits, {limits}")
                    }
                    Some(limits) => write!(f, "{quantity} is outside its limits, {limits}"),
                    None => quantity.write_rule(f),
                },
            },
        }
    }
}

impl core::error::Error for Invalid {}

/// The reason why a lockstep scene has no lookahead.
pub(super) const LOOKAHEAD_IN_LOCKSTEP: &str =
    "a lockstep scene publishes its ticks at once: make it free-running to publish with lookahead";

/// A number with its unit.
struct Measured(f64, &'static str);

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(value, unit) = *self;
        let size = value.abs();
        // As it was given: a double shows the digits that its f32 does not have.
        let near = value as f32;
        match (
            f64::from(near) == value,
            value == 0.0 || (1e-4..1e7).contains(&size),
        ) {
            (true, true) => write!(f, "{near}")?,
            (true, false) => write!(f, "{near:e}")?,
            (false, true) => write!(f, "{value}")?,
            (false, false) => write!(f, "{value:e}")?,
        }
        match unit {
            "" => Ok(()),
            unit => write!(f, " {unit}"),
        }
    }
}

/// Inclusive limits of a number.
struct NumberRange {
    least: f64,
    most: f64,
    unit: &'static str,
}

impl fmt::Display for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { least, most, unit } = *self;
        write!(f, "{} to {}", Measured(least, ""), Measured(most, unit))
    }
}

/// Checks a number against inclusive bounds.
pub(super) fn scalar(value: f32, least: f32, most: f32, quantity: Quantity) -> Result<(), Invalid> {
    let rule = match (value.is_finite(), value < least || value > most) {
        (true, false) => return Ok(()),
        (true, true) => Rule::OutOfRange,
        (false, _) => Rule::NotFinite,
    };
    let [value, least, most] = [value, least, most].map(f64::from);
    Err(outside(rule, quantity, [value, least, most]))
}

/// Checks a count against inclusive bounds.
pub(crate) fn count(
    value: usize,
    least: usize,
    most: usize,
    quantity: Quantity,
) -> Result<(), Invalid> {
    match (least..=most).contains(&value) {
        true => Ok(()),
        false => {
            let numbers = [value, least, most].map(|number| number as f64);
            Err(outside(Rule::OutOfRange, quantity, numbers))
        }
    }
}

/// The error of a number: its value, the least and the most.
pub(super) const fn outside(
    rule: Rule,
    quantity: Quantity,
    [value, least, most]: [f64; 3],
) -> Invalid {
    Invalid {
        rule,
        quantity,
        found: Found::Number {
            name: None,
            unit: quantity.unit(),
            value,
            least,
            most,
            advice: None,
        },
    }
}

/// Checks that each component of a vector is at most `most` in size.
pub(super) fn vector(value: Vec3, most: f32, quantity: Quantity) -> Result<(), Invalid> {
    for part in value.to_array() {
        scalar(part, -most, most, quantity)?;
    }
    Ok(())
}

/// A direction of unit length, by the rule for rotations.
pub(super) fn direction(value: Vec3, name: &'static str) -> Result<(), Invalid> {
    let as_rotation = rotation(Quat::from_vec4(value.extend(0.0)));
    as_rotation.map_err(|wrong| wrong.of(name, ""))
}

/// A quaternion of unit length, by the rule for body states (RECKONING 1.6).
pub(super) fn rotation(value: Quat) -> Result<(), Invalid> {
    let squared: f64 = value
        .to_array()
        .iter()
        .map(|&c| f64::from(c) * f64::from(c))
        .sum();
    let length = libm::sqrt(squared);
    if (length - 1.0).abs() <= UNIT_LENGTH_SLACK {
        return Ok(());
    }
    Err(Invalid {
        rule: Rule::NotFinite,
        quantity: Quantity::Rotation,
        found: Found::Length {
            name: "rotation x, y, z, w",
            length,
        },
    })
}

#[cfg(test)]
mod tests {
    use alloc::string::ToString;

    use super::*;

    #[test]
    fn an_error_names_the_value_the_limits_and_the_unit() {
        let wrong = |value| scalar(value, EXTENT_MIN, EXTENT_MAX, Quantity::Extent).unwrap_err();
        for (value, text) in [
            (-1.0, "shape extent is -1 m, and must be 0.001 to 10000 m"),
            (1e12, "shape extent is 1e12 m, and must be 0.001 to 10000 m"),
            (
                f32::NAN,
                "shape extent is NaN m, and must be 0.001 to 10000 m",
            ),
        ] {
            assert_eq!(wrong(value).to_string(), text);
        }
        let radius = wrong(0.0).of("radius of a ball", "m").to_string();
        assert_eq!(
            radius,
            "radius of a ball is 0 m, and must be 0.001 to 10000 m"
        );
        let points = count(3, 4, 255, Quantity::HullPoints).unwrap_err();
        assert_eq!(
            points.to_string(),
            "number of a hull's points is 3, and must be 4 to 255"
        );
        let turned = rotation(Quat::from_xyzw(0.0, 0.0, 0.0, 2.0)).unwrap_err();
        let text = "rotation x, y, z, w has the length 2, and must be of unit length";
        assert_eq!(turned.to_string(), text);
    }

    #[test]
    fn what_another_machine_found_is_equal_and_names_the_limits() {
        let here = scalar(-1.0, DENSITY_MIN, DENSITY_MAX, Quantity::Density).unwrap_err();
        let there = Invalid::out_of_range(Quantity::Density);
        assert_eq!(here, there);
        assert_ne!(here, Invalid::not_finite(Quantity::Density));
        assert_ne!(here, Invalid::out_of_range(Quantity::Mass));
        assert_eq!(
            there.to_string(),
            "density is outside its limits, 0.001 to 1000000 kg/m³"
        );
        for code in 0.. {
            let Some(quantity) = Quantity::from_code(code) else {
                break;
            };
            let text = Invalid::out_of_range(quantity).to_string();
            assert!(text.starts_with(&quantity.to_string()), "{text}");
        }
    }
}
