//! Commands of members to a scene, and the reasons of refusals.
//!
//! A command is checked as a whole before it is applied; a refused one changes nothing.

use core::fmt;

use glam::{Quat, Vec3};
use rhumb_reckoning::{BodyId, BodyState};

use super::body::BodyDesc;
use super::checks::{Invalid, Quantity, rotation, vector};
use super::joint::{Joint, JointId};
use super::shape::Shape;
use super::shape_id::ShapeId;
use crate::limits::{ANGULAR_MAX, COORDINATE_MAX, FORCE_MAX, GRAVITY_MAX, LINEAR_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, OPTIONAL, Wire};

/// One command, applied before the next tick in the order of sending.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Adds a shape.
    AddShape {
        /// Its id, which must be free.
        id: ShapeId,
        /// The shape.
        shape: Shape,
    },
    /// Removes a shape that no body has.
    RemoveShape {
        /// The shape.
        id: ShapeId,
    },
    /// Adds a body to the scene.
    AddBody {
        /// Its description; its index is one of the member's own.
        desc: BodyDesc,
        /// Its pose and velocities.
        motion: BodyState,
    },
    /// Removes a body.
    RemoveBody {
        /// The body.
        id: BodyId,
    },
    /// Displaces a static or dynamic body at once; moves a kinematic one there during the next tick.
    SetPose {
        /// The body.
        id: BodyId,
        /// Metres, world frame.
        position: Vec3,
        /// Body → world.
        rotation: Quat,
    },
    /// Sets both velocities; a kinematic body then keeps them.
    SetVelocity {
        /// The body.
        id: BodyId,
        /// m/s, world frame.
        linear: Vec3,
        /// rad/s about world axes.
        angular: Vec3,
    },
    /// Applies a force at the centre of mass during the next tick.
    Force {
        /// The body.
        id: BodyId,
        /// N, world frame.
        force: Vec3,
    },
    /// Applies a torque during the next tick.
    Torque {
        /// The body.
        id: BodyId,
        /// N·m, world frame.
        torque: Vec3,
    },
    /// Applies an impulse at the centre of mass: changes the velocity at once.
    Impulse {
        /// The body.
        id: BodyId,
        /// N·s, world frame.
        impulse: Vec3,
    },
    /// Applies an angular impulse: changes the spin at once.
    TorqueImpulse {
        /// The body.
        id: BodyId,
        /// N·m·s, world frame.
        impulse: Vec3,
    },
    /// Changes the scene's gravity.
    SetGravity {
        /// m/s², world frame.
        gravity: Vec3,
    },
    /// Joins two bodies.
    AddJoint {
        /// Its id, which must be free.
        id: JointId,
        /// The joint.
        joint: Joint,
    },
    /// Removes a joint; a joint goes with either of its bodies too.
    RemoveJoint {
        /// The joint.
        id: JointId,
    },
}

impl Command {
    /// Checks every number, as both ends do.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        match *self {
            Self::AddShape { ref shape, .. } => shape.check(),
            Self::AddJoint { ref joint, .. } => joint.check(),
            Self::RemoveShape { .. } | Self::RemoveBody { .. } | Self::RemoveJoint { .. } => Ok(()),
            Self::AddBody { desc, motion } => {
                desc.check()?;
                Self::check_motion(&motion)
            }
            Self::SetPose {
                position,
                rotation: turned,
                ..
            } => {
                vector(position, COORDINATE_MAX, Quantity::Position)?;
                rotation(turned)
            }
            Self::SetVelocity {
                linear, angular, ..
            } => {
                vector(linear, LINEAR_MAX, Quantity::Linear)?;
                vector(angular, ANGULAR_MAX, Quantity::Angular)
            }
            Self::Force { force, .. } => vector(force, FORCE_MAX, Quantity::Force),
            Self::Torque { torque, .. } => vector(torque, FORCE_MAX, Quantity::Torque),
            Self::Impulse { impulse, .. } => vector(impulse, FORCE_MAX, Quantity::Impulse),
            Self::TorqueImpulse { impulse, .. } => {
                vector(impulse, FORCE_MAX, Quantity::TorqueImpulse)
            }
            Self::SetGravity { gravity } => vector(gravity, GRAVITY_MAX, Quantity::Gravity),
        }
    }

    /// Checks every number of a commanded motion.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check_motion(motion: &BodyState) -> Result<(), Invalid> {
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
        vector(Vec3::new(px, py, pz), COORDINATE_MAX, Quantity::Position)?;
        rotation(Quat::from_xyzw(x, y, z, w))?;
        vector(Vec3::new(vx, vy, vz), LINEAR_MAX, Quantity::Linear)?;
        vector(Vec3::new(wx, wy, wz), ANGULAR_MAX, Quantity::Angular)
    }
}

/// First byte of each command.
mod code {
    pub(super) const ADD_SHAPE: u8 = 0;
    pub(super) const REMOVE_SHAPE: u8 = 1;
    pub(super) const ADD_BODY: u8 = 2;
    pub(super) const REMOVE_BODY: u8 = 3;
    pub(super) const SET_POSE: u8 = 4;
    pub(super) const SET_VELOCITY: u8 = 5;
    pub(super) const FORCE: u8 = 6;
    pub(super) const TORQUE: u8 = 7;
    pub(super) const IMPULSE: u8 = 8;
    pub(super) const TORQUE_IMPULSE: u8 = 9;
    pub(super) const SET_GRAVITY: u8 = 10;
    pub(super) const ADD_JOINT: u8 = 11;
    pub(super) const REMOVE_JOINT: u8 = 12;
}

impl Wire for Command {
    fn encode(&self, to: &mut Writer) {
        let mut push = |code, id: BodyId, vector: Vec3| {
            to.u8(code);
            id.encode(to);
            to.f32s(&vector.to_array());
        };
        match *self {
            Self::Force { id, force } => push(code::FORCE, id, force),
            Self::Torque { id, torque } => push(code::TORQUE, id, torque),
            Self::Impulse { id, impulse } => push(code::IMPULSE, id, impulse),
            Self::TorqueImpulse { id, impulse } => push(code::TORQUE_IMPULSE, id, impulse),
            Self::AddShape { id, ref shape } => {
                to.u8(code::ADD_SHAPE);
                id.encode(to);
                shape.encode(to);
            }
            Self::RemoveShape { id } => {
                to.u8(code::REMOVE_SHAPE);
                id.encode(to);
            }
            Self::AddBody { desc, motion } => {
                to.u8(code::ADD_BODY);
                desc.encode(to);
                motion.encode(to);
            }
            Self::RemoveBody { id } => {
                to.u8(code::REMOVE_BODY);
                id.encode(to);
            }
            Self::SetPose {
                id,
                position,
                rotation,
            } => {
                to.u8(code::SET_POSE);
                id.encode(to);
                to.f32s(&position.to_array());
                to.f32s(&rotation.to_array());
            }
            Self::SetVelocity {
                id,
                linear,
                angular,
            } => {
                to.u8(code::SET_VELOCITY);
                id.encode(to);
                to.f32s(&linear.to_array());
                to.f32s(&angular.to_array());
            }
            Self::SetGravity { gravity } => {
                to.u8(code::SET_GRAVITY);
                to.f32s(&gravity.to_array());
            }
            Self::AddJoint { id, joint } => {
                to.u8(code::ADD_JOINT);
                id.encode(to);
                joint.encode(to);
            }
            Self::RemoveJoint { id } => {
                to.u8(code::REMOVE_JOINT);
                id.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let vector = |from: &mut Reader<'_>| from.f32s().map(Vec3::from_array);
        Ok(match from.u8()? {
            code::ADD_SHAPE => Self::AddShape {
                id: ShapeId::decode(from)?,
                shape: Shape::decode(from)?,
            },
            code::REMOVE_SHAPE => Self::RemoveShape {
                id: ShapeId::decode(from)?,
            },
            code::ADD_BODY => Self::AddBody {
                desc: BodyDesc::decode(from)?,
                motion: BodyState::decode(from)?,
            },
            code::REMOVE_BODY => Self::RemoveBody {
                id: BodyId::decode(from)?,
            },
            code::SET_POSE => Self::SetPose {
                id: BodyId::decode(from)?,
                position: vector(from)?,
                rotation: Quat::from_array(from.f32s()?),
            },
            code::SET_VELOCITY => Self::SetVelocity {
                id: BodyId::decode(from)?,
                linear: vector(from)?,
                angular: vector(from)?,
            },
            code::FORCE => Self::Force {
                id: BodyId::decode(from)?,
                force: vector(from)?,
            },
            code::TORQUE => Self::Torque {
                id: BodyId::decode(from)?,
                torque: vector(from)?,
            },
            code::IMPULSE => Self::Impulse {
                id: BodyId::decode(from)?,
                impulse: vector(from)?,
            },
            code::TORQUE_IMPULSE => Self::TorqueImpulse {
                id: BodyId::decode(from)?,
                impulse: vector(from)?,
            },
            code::SET_GRAVITY => Self::SetGravity {
                gravity: vector(from)?,
            },
            code::ADD_JOINT => Self::AddJoint {
                id: JointId::decode(from)?,
                joint: Joint::decode(from)?,
            },
            code::REMOVE_JOINT => Self::RemoveJoint {
                id: JointId::decode(from)?,
            },
            OPTIONAL.. => return Err(Malformed::UnknownCommand),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// Bits of the byte before an exact motion that tell which of its parts follow.
mod part {
    pub(super) const ROTATION: u8 = 1;
    pub(super) const LINEAR: u8 = 2;
    pub(super) const ANGULAR: u8 = 4;
}

/// The bits of the identity quaternion.
const IDENTITY_BITS: [u32; 4] = [0, 0, 0, 1.0_f32.to_bits()];

impl Wire for BodyState {
    fn encode(&self, to: &mut Writer) {
        let parts = self.parts();
        let bits = parts.map(f32::to_bits);
        let (rotation, linear, angular) = (&parts[3..7], &parts[7..10], &parts[10..]);
        let mut present = 0;
        if bits[3..7] != IDENTITY_BITS {
            present |= part::ROTATION;
        }
        if bits[7..10] != [0; 3] {
            present |= part::LINEAR;
        }
        if bits[10..] != [0; 3] {
            present |= part::ANGULAR;
        }
        to.u8(present);
        to.f32s(&parts[..3]);
        for (values, bit) in [
            (rotation, part::ROTATION),
            (linear, part::LINEAR),
            (angular, part::ANGULAR),
        ] {
            if present & bit != 0 {
                to.f32s(values);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let present = from.u8()?;
        if present > (part::ROTATION | part::LINEAR | part::ANGULAR) {
            return Err(Malformed::UnknownCode);
        }
        let position = from.f32s()?;
        let mut rotation = IDENTITY_BITS.map(f32::from_bits);
        let (mut linear, mut angular) = ([0.0; 3], [0.0; 3]);
        if present & part::ROTATION != 0 {
            rotation = canonical(from.f32s()?, IDENTITY_BITS)?;
        }
        if present & part::LINEAR != 0 {
            linear = canonical(from.f32s()?, [0; 3])?;
        }
        if present & part::ANGULAR != 0 {
            angular = canonical(from.f32s()?, [0; 3])?;
        }
        Self::new(position, rotation, linear, angular).map_err(Malformed::Motion)
    }
}

/// Refuses a part that the encoding omits.
fn canonical<const N: usize>(values: [f32; N], left_out: [u32; N]) -> Result<[f32; N], Malformed> {
    if values.map(f32::to_bits) == left_out {
        return Err(Malformed::NotCanonical);
    }
    Ok(values)
}

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
    /// A reason of a later version; the code is from [`OPTIONAL`] on.
    Other(u8),
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
            Self::TooManyBodies => f.write_str("the scene has reached its limit of bodies"),
            Self::TooManyDampings => {
                f.write_str("the scene's bodies have reached the limit of different dampings")
            }
            Self::NotPushable(id) => write!(f, "{id} is static or kinematic and cannot be pushed"),
            Self::SceneFaulted => f.write_str("the scene has faulted and takes no commands"),
            Self::ShapeUnfit(id) => write!(f, "the engine cannot make a solid of {id}"),
            Self::UnknownJoint(id) => write!(f, "the scene has no {id}"),
            Self::JointIdTaken(id) => write!(f, "{id} is taken"),
            Self::JoinedToItself(id) => write!(f, "a joint cannot join {id} to itself"),
            Self::UnderAuthority(id) => {
                write!(f, "a member has authority over {id}")
            }
            Self::NoInside(id) => write!(f, "{id} has no volume, and a dynamic body needs one"),
            Self::TooManyShapeBytes => {
                f.write_str("the scene's shapes have reached their limit of bytes")
            }
            Self::UnknownCommand => f.write_str("the server does not know such a command"),
            Self::NotAllowed => {
                f.write_str("the client may not do that, or not to what belongs to another client")
            }
            Self::OverQuota => f.write_str("the command exceeds a quota of the client's token"),
            Self::Other(code) => write!(f, "the server gave an unknown reason, number {code}"),
        }
    }
}

impl core::error::Error for CommandError {}

impl Wire for CommandError {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Invalid(Invalid::NotFinite(quantity)) => {
                to.u8(0);
                to.u8(quantity.code());
            }
            Self::Invalid(Invalid::OutOfRange(quantity)) => {
                to.u8(1);
                to.u8(quantity.code());
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
            Self::NotAllowed => to.u8(32),
            Self::OverQuota => to.u8(33),
            Self::Other(code) => to.u8(code),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let quantity =
            |from: &mut Reader<'_>| Quantity::from_code(from.u8()?).ok_or(Malformed::UnknownCode);
        Ok(match from.u8()? {
            0 => Self::Invalid(Invalid::NotFinite(quantity(from)?)),
            1 => Self::Invalid(Invalid::OutOfRange(quantity(from)?)),
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
            32 => Self::NotAllowed,
            33 => Self::OverQuota,
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
