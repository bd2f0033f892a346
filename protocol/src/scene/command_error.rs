//! Reasons why a server refuses a command.

use core::fmt;

use rhumb_reckoning::BodyId;

use super::checks::{Invalid, Quantity, Rule};
use super::joint::JointId;
use super::shape::ShapeId;
use crate::limits::{
    BODIES_MAX, CHARACTERS_MAX, DAMPINGS_MAX, JOINTS_BESIDE, JOINTS_PER_BODY,
    SHAPE_BYTES_PER_SCENE_MAX, SWEPT_BODIES_MAX, VEHICLES_MAX,
};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// Reason of a refused command, which had no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CommandError {
    /// A number is not allowed.
    Invalid(Invalid),
    /// The body does not exist.
    UnknownBody(BodyId),
    /// The shape does not exist.
    UnknownShape(ShapeId),
    /// The body's index is in use, or had a body of this generation or a later one.
    BodyIdTaken(BodyId),
    /// The body's index is not one of the member's own.
    NotGranted(BodyId),
    /// The shape's number is in use.
    ShapeIdTaken(ShapeId),
    /// A body has the shape.
    ShapeInUse(ShapeId),
    /// The scene has reached its limit of bodies.
    TooManyBodies,
    /// The scene's bodies have reached the limit of different dampings.
    TooManyDampings,
    /// The body is not of a kind that can be pushed.
    NotPushable(BodyId),
    /// The scene has faulted and takes no commands.
    SceneFaulted,
    /// The engine cannot make a solid of the shape.
    ShapeUnfit(ShapeId),
    /// The joint does not exist.
    UnknownJoint(JointId),
    /// The joint's number is in use.
    JointIdTaken(JointId),
    /// The joint would join a body to itself.
    JoinedToItself(BodyId),
    /// A member has authority over the body, and alone moves it.
    UnderAuthority(BodyId),
    /// A dynamic body needs a shape with volume.
    NoInside(ShapeId),
    /// The scene's shapes have reached their limit of bytes.
    TooManyShapeBytes,
    /// The server does not know such a command.
    UnknownCommand,
    /// The client's role does not include the command, or the body, shape or joint belongs to another client.
    NotAllowed,
    /// The command exceeds a quota of the client's token.
    OverQuota,
    /// The machine has no time left for the body; a later attempt may succeed.
    Overloaded {
        /// When to try again, seconds from now.
        retry_seconds: u8,
    },
    /// The engine failed on the command, and the scene continues without it. It may have been applied before.
    EngineFailed,
    /// The solid of the shape takes longer to make than the server allows.
    ShapeTooSlow {
        /// The server's limit, milliseconds.
        limit_ms: u32,
    },
    /// The body would overlap so many others that a step would not end in time.
    TooCrowded,
    /// The body is disabled and takes neither velocities nor pushes.
    BodyDisabled(BodyId),
    /// The scene has reached its limit of joints, which grows with its bodies.
    TooManyJoints,
    /// The scene has reached its limit of bodies that are swept against moving ones.
    TooManySwept,
    /// The engine of the scene has no such shape, joint, locomotion or property of bodies. A fed scene has no engine: no
    /// events, forces, characters or vehicles.
    Unsupported,
    /// The body is not kinematic, and only a kinematic one can be a character.
    NotKinematic(BodyId),
    /// A character needs one convex shape.
    NotConvex(ShapeId),
    /// The body is no character.
    NotCharacter(BodyId),
    /// The body is no vehicle.
    NotVehicle(BodyId),
    /// The scene has reached its limit of characters.
    TooManyCharacters,
    /// The scene has reached its limit of vehicles.
    TooManyVehicles,
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
}

impl CommandError {
    /// Its name in languages without enumerations.
    #[must_use]
    pub const fn word(&self) -> &'static str {
        match self {
            Self::Invalid(_) => "invalid",
            Self::UnknownBody(_) => "unknown body",
            Self::UnknownShape(_) => "unknown shape",
            Self::BodyIdTaken(_) => "body id taken",
            Self::NotGranted(_) => "not granted",
            Self::ShapeIdTaken(_) => "shape id taken",
            Self::ShapeInUse(_) => "shape in use",
            Self::TooManyBodies => "too many bodies",
            Self::TooManyDampings => "too many dampings",
            Self::NotPushable(_) => "not pushable",
            Self::SceneFaulted => "scene faulted",
            Self::ShapeUnfit(_) => "shape unfit",
            Self::UnknownJoint(_) => "unknown joint",
            Self::JointIdTaken(_) => "joint id taken",
            Self::JoinedToItself(_) => "joined to itself",
            Self::UnderAuthority(_) => "under authority",
            Self::NoInside(_) => "no inside",
            Self::TooManyShapeBytes => "too many shape bytes",
            Self::UnknownCommand => "unknown command",
            Self::NotAllowed => "not allowed",
            Self::OverQuota => "over quota",
            Self::Overloaded { .. } => "overloaded",
            Self::EngineFailed => "engine failed",
            Self::ShapeTooSlow { .. } => "shape too slow",
            Self::TooCrowded => "too crowded",
            Self::BodyDisabled(_) => "body disabled",
            Self::TooManyJoints => "too many joints",
            Self::TooManySwept => "too many swept",
            Self::Unsupported => "unsupported",
            Self::NotKinematic(_) => "not kinematic",
            Self::NotConvex(_) => "not convex",
            Self::NotCharacter(_) => "not a character",
            Self::NotVehicle(_) => "not a vehicle",
            Self::TooManyCharacters => "too many characters",
            Self::TooManyVehicles => "too many vehicles",
            Self::Other(_) => "other",
        }
    }

    /// The sentence of a scene that is full of something.
    fn write_limit(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooManyBodies => write!(
                f,
                "the scene has reached its limit of bodies, {BODIES_MAX} at most"
            ),
            Self::TooManyDampings => write!(
                f,
                "the scene's bodies have {DAMPINGS_MAX} different dampings, as many as they may: give the body one of these"
            ),
            Self::TooManyShapeBytes => write!(
                f,
                "the scene's shapes have reached their limit of bytes, {SHAPE_BYTES_PER_SCENE_MAX} at most: remove unused ones"
            ),
            Self::TooManyJoints => write!(
                f,
                "the scene has as many joints as its number of bodies allows, {JOINTS_PER_BODY} for each and {JOINTS_BESIDE}"
            ),
            Self::TooManySwept => write!(
                f,
                "the scene has reached its limit of bodies swept against moving ones, {SWEPT_BODIES_MAX} at most"
            ),
            Self::TooManyCharacters => write!(
                f,
                "the scene has reached its limit of characters, {CHARACTERS_MAX} at most"
            ),
            Self::TooManyVehicles => write!(
                f,
                "the scene has reached its limit of vehicles, {VEHICLES_MAX} at most"
            ),
            other => write!(f, "the scene has reached a limit: {}", other.word()),
        }
    }

    /// The body that it names.
    #[must_use]
    pub const fn body(&self) -> Option<BodyId> {
        match *self {
            Self::UnknownBody(id)
            | Self::BodyIdTaken(id)
            | Self::NotGranted(id)
            | Self::NotPushable(id)
            | Self::JoinedToItself(id)
            | Self::UnderAuthority(id)
            | Self::BodyDisabled(id)
            | Self::NotKinematic(id)
            | Self::NotCharacter(id)
            | Self::NotVehicle(id) => Some(id),
            _ => None,
        }
    }
}

impl fmt::Display for CommandError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Invalid(invalid) => invalid.fmt(f),
            Self::UnknownBody(id) => write!(f, "the scene has no {id}"),
            Self::UnknownShape(id) => write!(f, "the scene has no {id}"),
            Self::BodyIdTaken(id) => write!(f, "{id} is taken, or its index had a later body"),
            Self::NotGranted(id) => write!(f, "{id} is not one of this member's own"),
            Self::ShapeIdTaken(id) => write!(f, "{id} is taken"),
            Self::ShapeInUse(id) => write!(f, "a body still has {id}"),
            Self::NotPushable(id) => write!(f, "{id} is fixed or kinematic and cannot be pushed, as dynamic bodies can; a kinematic one moves by a pose or a velocity that is set"),
            Self::SceneFaulted => f.write_str("the scene has faulted and takes no commands"),
            Self::ShapeUnfit(id) => write!(f, "the engine cannot make a solid of {id}"),
            Self::UnknownJoint(id) => write!(f, "the scene has no {id}"),
            Self::JointIdTaken(id) => write!(f, "{id} is taken"),
            Self::JoinedToItself(id) => write!(f, "a joint cannot join {id} to itself"),
            Self::UnderAuthority(id) => {
                write!(f, "a member has authority over {id}")
            }
            Self::NoInside(id) => write!(f, "{id} has no volume, and a dynamic body needs one"),
            Self::UnknownCommand => f.write_str("the server does not know such a command"),
            Self::NotAllowed => {
                f.write_str("the client may not do that, or not to what belongs to another client")
            }
            Self::OverQuota => f.write_str("the command exceeds a quota of the client's token"),
            Self::Overloaded { retry_seconds } => write!(
                f,
                "the server has no time or room left for it; try again in {retry_seconds} s, in a lockstep scene after a step"
            ),
            Self::EngineFailed => {
                f.write_str("the physics engine failed on it, and the scene continues without it")
            }
            Self::ShapeTooSlow { limit_ms } => write!(
                f,
                "the solid of the shape takes longer than {limit_ms} ms to make, the server's limit"
            ),
            Self::TooCrowded => f.write_str(
                "the body would overlap so many others that a step would not end in time, beyond the server's limits.scene_crowding: place it apart from them, or after a step",
            ),
            Self::BodyDisabled(id) => write!(f, "{id} is disabled"),
            Self::Unsupported => f.write_str(
                "the engine of the scene has no such shape, joint, locomotion or property of bodies; a scene that its owner feeds has no events, forces, characters or vehicles",
            ),
            Self::NotKinematic(id) => {
                write!(f, "{id} is not kinematic, and a character needs to be")
            }
            Self::NotConvex(id) => {
                write!(f, "{id} is not one convex solid, and a character needs one")
            }
            Self::NotCharacter(id) => write!(f, "{id} is no character"),
            Self::NotVehicle(id) => write!(f, "{id} is no vehicle"),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
            full => full.write_limit(f),
        }
    }
}

impl core::error::Error for CommandError {}

impl Wire for CommandError {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Invalid(invalid) => {
                to.u8(match invalid.rule {
                    Rule::NotFinite => 0,
                    Rule::OutOfRange => 1,
                });
                to.u8(invalid.quantity.code());
            }
            Self::UnknownBody(id) => named(to, 2, &id),
            Self::UnknownShape(id) => named(to, 3, &id),
            Self::BodyIdTaken(id) => named(to, 4, &id),
            Self::NotGranted(id) => named(to, 5, &id),
            Self::ShapeIdTaken(id) => named(to, 6, &id),
            Self::ShapeInUse(id) => named(to, 7, &id),
            Self::TooManyBodies => to.u8(8),
            Self::TooManyDampings => to.u8(9),
            Self::NotPushable(id) => named(to, 10, &id),
            Self::SceneFaulted => to.u8(11),
            Self::ShapeUnfit(id) => named(to, 12, &id),
            Self::UnknownJoint(id) => named(to, 13, &id),
            Self::JointIdTaken(id) => named(to, 14, &id),
            Self::JoinedToItself(id) => named(to, 15, &id),
            Self::UnderAuthority(id) => named(to, 16, &id),
            Self::NoInside(id) => named(to, 17, &id),
            Self::TooManyShapeBytes => to.u8(18),
            Self::UnknownCommand => to.u8(19),
            Self::BodyDisabled(id) => named(to, 20, &id),
            Self::TooManyJoints => to.u8(21),
            Self::TooManySwept => to.u8(22),
            Self::NotKinematic(id) => named(to, 23, &id),
            Self::NotConvex(id) => named(to, 24, &id),
            Self::NotCharacter(id) => named(to, 25, &id),
            Self::NotVehicle(id) => named(to, 26, &id),
            Self::TooManyCharacters => to.u8(27),
            Self::TooManyVehicles => to.u8(28),
            Self::NotAllowed => to.u8(32),
            Self::OverQuota => to.u8(33),
            Self::Overloaded { retry_seconds } => {
                to.u8(34);
                to.u8(retry_seconds);
            }
            Self::EngineFailed => to.u8(35),
            Self::ShapeTooSlow { limit_ms } => {
                to.u8(36);
                to.varint(u64::from(limit_ms));
            }
            Self::Unsupported => to.u8(37),
            Self::TooCrowded => to.u8(129),
            Self::Other(code) => to.u8(code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let quantity =
            |from: &mut Reader<'_>| Quantity::from_code(from.u8()?).ok_or(Malformed::UnknownCode);
        Ok(match from.u8()? {
            0 => Self::Invalid(Invalid::not_finite(quantity(from)?)),
            1 => Self::Invalid(Invalid::out_of_range(quantity(from)?)),
            2 => Self::UnknownBody(BodyId::decode(from)?),
            3 => Self::UnknownShape(ShapeId::decode(from)?),
            4 => Self::BodyIdTaken(BodyId::decode(from)?),
            5 => Self::NotGranted(BodyId::decode(from)?),
            6 => Self::ShapeIdTaken(ShapeId::decode(from)?),
            7 => Self::ShapeInUse(ShapeId::decode(from)?),
            8 => Self::TooManyBodies,
            9 => Self::TooManyDampings,
            10 => Self::NotPushable(BodyId::decode(from)?),
            11 => Self::SceneFaulted,
            12 => Self::ShapeUnfit(ShapeId::decode(from)?),
            13 => Self::UnknownJoint(JointId::decode(from)?),
            14 => Self::JointIdTaken(JointId::decode(from)?),
            15 => Self::JoinedToItself(BodyId::decode(from)?),
            16 => Self::UnderAuthority(BodyId::decode(from)?),
            17 => Self::NoInside(ShapeId::decode(from)?),
            18 => Self::TooManyShapeBytes,
            19 => Self::UnknownCommand,
            20 => Self::BodyDisabled(BodyId::decode(from)?),
            21 => Self::TooManyJoints,
            22 => Self::TooManySwept,
            23 => Self::NotKinematic(BodyId::decode(from)?),
            24 => Self::NotConvex(ShapeId::decode(from)?),
            25 => Self::NotCharacter(BodyId::decode(from)?),
            26 => Self::NotVehicle(BodyId::decode(from)?),
            27 => Self::TooManyCharacters,
            28 => Self::TooManyVehicles,
            32 => Self::NotAllowed,
            33 => Self::OverQuota,
            34 => Self::Overloaded {
                retry_seconds: from.u8()?,
            },
            35 => Self::EngineFailed,
            36 => Self::ShapeTooSlow {
                limit_ms: from.varint32()?,
            },
            37 => Self::Unsupported,
            129 => Self::TooCrowded,
            code @ OPTIONAL.. => Self::Other(code),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// Encodes a code, then the id that the error is about.
fn named(to: &mut Writer, code: u8, id: &impl Wire) {
    to.u8(code);
    id.encode(to);
}
