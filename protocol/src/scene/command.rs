//! Commands of members to a scene.
//!
//! A command is checked as a whole before it is applied; a refused one changes nothing.

use alloc::boxed::Box;
use alloc::vec::Vec;

use glam::{Quat, Vec3};
use rhumb_reckoning::{BodyId, BodyState};

use super::body::BodyDesc;
use super::body_event::ActiveEvents;
use super::checks::{Invalid, Quantity, rotation, scalar, vector};
use super::ids::IdOutOfRange;
use super::joint::{IDENTITY_BITS, Joint, JointId};
use super::locomotion::{JumpFrom, Locomotion, WheelInput, decode_each, encode_each};
use super::shape::{Shape, ShapeId};
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
    /// Displaces a fixed or dynamic body at once; moves a kinematic one there during the next tick.
    ///
    /// If poses of a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the
    /// next, and carries what lies on it. It stops at the last one. A pose that is farther than 100 m/s or a quarter of
    /// a turn in a tick from where its motion leads is a jump that shoves nothing. A velocity that is set after the pose
    /// has it there after one tick; it continues at that velocity.
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
    /// Applies a force at the centre of mass during the next tick. As any push, it is refused if it makes the body too
    /// fast.
    Force {
        /// The body.
        id: BodyId,
        /// N, world frame.
        force: Vec3,
    },
    /// Applies a torque during the next tick. As any push, it is refused if it makes the body too fast.
    Torque {
        /// The body.
        id: BodyId,
        /// N·m, world frame.
        torque: Vec3,
    },
    /// Applies an impulse at the centre of mass: changes the velocity at once. As any push, it is refused if it makes the
    /// body too fast.
    Impulse {
        /// The body.
        id: BodyId,
        /// N·s, world frame.
        impulse: Vec3,
    },
    /// Applies an angular impulse: changes the spin at once. As any push, it is refused if it makes the body too fast.
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
        joint: Box<Joint>,
    },
    /// Removes a joint; a joint goes with either of its bodies too.
    RemoveJoint {
        /// The joint.
        id: JointId,
    },
    /// Replaces the description of a body; pose and velocities stay.
    ChangeBody {
        /// The new description, whole.
        desc: BodyDesc,
    },
    /// Replaces a joint, its motors among others.
    ChangeJoint {
        /// Its id.
        id: JointId,
        /// The new joint, whole.
        joint: Box<Joint>,
    },
    /// Applies a force at a point during the next tick. As any push, it is refused if it makes the body too fast.
    ForceAt {
        /// The body.
        id: BodyId,
        /// N, world frame.
        force: Vec3,
        /// Metres, world frame.
        point: Vec3,
    },
    /// Applies an impulse at a point: changes both velocities at once. As any push, it is refused if it makes the body
    /// too fast.
    ImpulseAt {
        /// The body.
        id: BodyId,
        /// N·s, world frame.
        impulse: Vec3,
        /// Metres, world frame.
        point: Vec3,
    },
    /// Puts a dynamic body to sleep. It wakes when something touches it that moves.
    Sleep {
        /// The body.
        id: BodyId,
    },
    /// Wakes a dynamic body.
    Wake {
        /// The body.
        id: BodyId,
    },
    /// Turns the events of a body on or off.
    SetEvents {
        /// The body.
        id: BodyId,
        /// The events that it reports from now on.
        events: ActiveEvents,
    },
    /// Makes a kinematic body a character or a dynamic one a vehicle, in place of what it was before. A character keeps
    /// its fall; the wheels of a vehicle begin without inputs.
    SetLocomotion {
        /// The body.
        id: BodyId,
        /// Its locomotion from now on.
        locomotion: Box<Locomotion>,
    },
    /// Sets the speed with which a character rises.
    Jump {
        /// The character.
        id: BodyId,
        /// m/s along its direction up.
        speed: f32,
        /// The ground that it needs.
        from: JumpFrom,
    },
    /// Sets steering, force and brake of each wheel of a vehicle, which keeps them.
    SetWheels {
        /// The vehicle.
        id: BodyId,
        /// One for each wheel, in their order.
        inputs: Vec<WheelInput>,
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
            Self::AddJoint { ref joint, .. } | Self::ChangeJoint { ref joint, .. } => joint.check(),
            Self::RemoveShape { .. }
            | Self::RemoveBody { .. }
            | Self::RemoveJoint { .. }
            | Self::Sleep { .. }
            | Self::Wake { .. } => Ok(()),
            Self::ChangeBody { desc } => desc.check(),
            Self::AddBody { desc, motion } => {
                desc.check()?;
                Self::check_motion(&motion)
            }
            Self::SetPose {
                position,
                rotation: turned,
                ..
            } => Self::check_pose(position, turned),
            Self::SetVelocity {
                linear, angular, ..
            } => Self::check_velocity(linear, angular),
            Self::Force { force, .. } => vector(force, FORCE_MAX, Quantity::Force),
            Self::Torque { torque, .. } => vector(torque, FORCE_MAX, Quantity::Torque),
            Self::Impulse { impulse, .. } => vector(impulse, FORCE_MAX, Quantity::Impulse),
            Self::ForceAt { force, point, .. } => {
                vector(force, FORCE_MAX, Quantity::Force)?;
                vector(point, COORDINATE_MAX, Quantity::Position)
            }
            Self::ImpulseAt { impulse, point, .. } => {
                vector(impulse, FORCE_MAX, Quantity::Impulse)?;
                vector(point, COORDINATE_MAX, Quantity::Position)
            }
            Self::TorqueImpulse { impulse, .. } => {
                vector(impulse, FORCE_MAX, Quantity::TorqueImpulse)
            }
            Self::SetGravity { gravity } => vector(gravity, GRAVITY_MAX, Quantity::Gravity),
            Self::SetEvents { events, .. } => events.check(),
            Self::SetLocomotion { ref locomotion, .. } => locomotion.check(),
            Self::Jump { speed, .. } => scalar(speed, -LINEAR_MAX, LINEAR_MAX, Quantity::Linear)
                .map_err(|wrong| wrong.of("speed of a jump", "m/s")),
            Self::SetWheels { ref inputs, .. } => WheelInput::check_all(inputs),
        }
    }

    /// Checks every id, as a client does before it sends. A server that reads the command finds no other ids in it.
    ///
    /// # Errors
    ///
    /// [`IdOutOfRange`] names the first id that no scene can have.
    pub fn check_ids(&self) -> Result<(), IdOutOfRange> {
        match *self {
            Self::AddShape { id, .. } | Self::RemoveShape { id } => IdOutOfRange::check_shape(id),
            Self::AddBody { desc, .. } | Self::ChangeBody { desc } => {
                IdOutOfRange::check_body(desc.id)?;
                IdOutOfRange::check_shape(desc.shape)
            }
            Self::AddJoint { id, ref joint } | Self::ChangeJoint { id, ref joint } => {
                IdOutOfRange::check_joint(id)?;
                (joint.bodies.into_iter()).try_for_each(IdOutOfRange::check_body)
            }
            Self::RemoveJoint { id } => IdOutOfRange::check_joint(id),
            _ => self.body().map_or(Ok(()), IdOutOfRange::check_body),
        }
    }

    /// The body that it adds, changes, moves or removes; of a joint the first one. `None` for gravity, a shape, and the
    /// removal of a joint.
    #[must_use]
    pub const fn body(&self) -> Option<BodyId> {
        match self {
            Self::AddShape { .. }
            | Self::RemoveShape { .. }
            | Self::RemoveJoint { .. }
            | Self::SetGravity { .. } => None,
            Self::AddBody { desc, .. } | Self::ChangeBody { desc } => Some(desc.id),
            Self::AddJoint { joint, .. } | Self::ChangeJoint { joint, .. } => Some(joint.bodies[0]),
            Self::RemoveBody { id }
            | Self::SetPose { id, .. }
            | Self::SetVelocity { id, .. }
            | Self::Force { id, .. }
            | Self::Torque { id, .. }
            | Self::Impulse { id, .. }
            | Self::TorqueImpulse { id, .. }
            | Self::ForceAt { id, .. }
            | Self::ImpulseAt { id, .. }
            | Self::Sleep { id }
            | Self::Wake { id }
            | Self::SetEvents { id, .. }
            | Self::SetLocomotion { id, .. }
            | Self::Jump { id, .. }
            | Self::SetWheels { id, .. } => Some(*id),
        }
    }

    /// Checks every number of a commanded motion.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub(crate) fn check_motion(motion: &BodyState) -> Result<(), Invalid> {
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = motion.parts();
        Self::check_pose(Vec3::new(px, py, pz), Quat::from_xyzw(x, y, z, w))?;
        Self::check_velocity(Vec3::new(vx, vy, vz), Vec3::new(wx, wy, wz))
    }

    /// Checks a pose: metres, and a unit quaternion.
    pub(super) fn check_pose(position: Vec3, turned: Quat) -> Result<(), Invalid> {
        vector(position, COORDINATE_MAX, Quantity::Position)?;
        rotation(turned)
    }

    /// Checks velocities: m/s and rad/s.
    pub(super) fn check_velocity(linear: Vec3, angular: Vec3) -> Result<(), Invalid> {
        vector(linear, LINEAR_MAX, Quantity::Linear)?;
        vector(angular, ANGULAR_MAX, Quantity::Angular)
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
    pub(super) const CHANGE_BODY: u8 = 13;
    pub(super) const CHANGE_JOINT: u8 = 14;
    pub(super) const FORCE_AT: u8 = 15;
    pub(super) const IMPULSE_AT: u8 = 16;
    pub(super) const SLEEP: u8 = 17;
    pub(super) const WAKE: u8 = 18;
    pub(super) const SET_EVENTS: u8 = 19;
    pub(super) const SET_LOCOMOTION: u8 = 20;
    pub(super) const JUMP: u8 = 21;
    pub(super) const SET_WHEELS: u8 = 22;
}

/// Encodes a command's code and its first field.
fn encode_head(to: &mut Writer, code: u8, first: &impl Wire) {
    to.u8(code);
    first.encode(to);
}

/// Encodes a command's code and its two fields.
fn encode_pair(to: &mut Writer, code: u8, first: &impl Wire, second: &impl Wire) {
    encode_head(to, code, first);
    second.encode(to);
}

/// Encodes a push on a body, up to its point.
fn encode_push(to: &mut Writer, code: u8, id: BodyId, push: Vec3) {
    encode_head(to, code, &id);
    to.f32s(&push.to_array());
}

fn encode_gravity(to: &mut Writer, gravity: Vec3) {
    to.u8(code::SET_GRAVITY);
    to.f32s(&gravity.to_array());
}

/// Encodes a push on a body and its point.
fn encode_push_at(to: &mut Writer, code: u8, id: BodyId, [push, point]: [Vec3; 2]) {
    encode_push(to, code, id, push);
    to.f32s(&point.to_array());
}

/// Decodes a push on a body behind its code.
fn decode_push(code: u8, from: &mut Reader<'_>) -> Result<Command, Malformed> {
    let vector = |from: &mut Reader<'_>| from.f32s().map(Vec3::from_array);
    let id = BodyId::decode(from)?;
    let push = vector(from)?;
    Ok(match code {
        code::FORCE => Command::Force { id, force: push },
        code::TORQUE => Command::Torque { id, torque: push },
        code::IMPULSE => Command::Impulse { id, impulse: push },
        code::TORQUE_IMPULSE => Command::TorqueImpulse { id, impulse: push },
        code::FORCE_AT => Command::ForceAt {
            id,
            force: push,
            point: vector(from)?,
        },
        code::IMPULSE_AT => Command::ImpulseAt {
            id,
            impulse: push,
            point: vector(from)?,
        },
        _ => return Err(Malformed::UnknownCode),
    })
}

/// Decodes a command about a body's locomotion behind its code.
fn decode_locomotion(code: u8, from: &mut Reader<'_>) -> Result<Command, Malformed> {
    let id = BodyId::decode(from)?;
    Ok(match code {
        code::SET_LOCOMOTION => Command::SetLocomotion {
            id,
            locomotion: Box::new(Locomotion::decode(from)?),
        },
        code::JUMP => Command::Jump {
            id,
            speed: from.f32()?,
            from: JumpFrom::decode(from)?,
        },
        code::SET_WHEELS => Command::SetWheels {
            id,
            inputs: decode_each(from)?,
        },
        _ => return Err(Malformed::UnknownCode),
    })
}

impl Wire for Command {
    fn encode(&self, to: &mut Writer) {
        match *self {
            Self::Force { id, force } => encode_push(to, code::FORCE, id, force),
            Self::Torque { id, torque } => encode_push(to, code::TORQUE, id, torque),
            Self::Impulse { id, impulse } => encode_push(to, code::IMPULSE, id, impulse),
            Self::TorqueImpulse { id, impulse } => {
                encode_push(to, code::TORQUE_IMPULSE, id, impulse);
            }
            Self::ForceAt { id, force, point } => {
                encode_push_at(to, code::FORCE_AT, id, [force, point]);
            }
            Self::ImpulseAt { id, impulse, point } => {
                encode_push_at(to, code::IMPULSE_AT, id, [impulse, point]);
            }
            Self::AddShape { id, ref shape } => {
                encode_pair(to, code::ADD_SHAPE, &id, shape);
            }
            Self::RemoveShape { id } => encode_head(to, code::REMOVE_SHAPE, &id),
            Self::AddBody { desc, motion } => {
                encode_pair(to, code::ADD_BODY, &desc, &motion);
            }
            Self::RemoveBody { id } => encode_head(to, code::REMOVE_BODY, &id),
            Self::SetPose {
                id,
                position,
                rotation,
            } => {
                encode_head(to, code::SET_POSE, &id);
                to.f32s(&position.to_array());
                to.f32s(&rotation.to_array());
            }
            Self::SetVelocity {
                id,
                linear,
                angular,
            } => {
                encode_head(to, code::SET_VELOCITY, &id);
                to.f32s(&linear.to_array());
                to.f32s(&angular.to_array());
            }
            Self::SetGravity { gravity } => encode_gravity(to, gravity),
            Self::AddJoint { id, ref joint } => {
                encode_pair(to, code::ADD_JOINT, &id, &**joint);
            }
            Self::RemoveJoint { id } => encode_head(to, code::REMOVE_JOINT, &id),
            Self::ChangeBody { desc } => encode_head(to, code::CHANGE_BODY, &desc),
            Self::ChangeJoint { id, ref joint } => {
                encode_pair(to, code::CHANGE_JOINT, &id, &**joint);
            }
            Self::Sleep { id } => encode_head(to, code::SLEEP, &id),
            Self::Wake { id } => encode_head(to, code::WAKE, &id),
            Self::SetEvents { id, events } => {
                encode_pair(to, code::SET_EVENTS, &id, &events);
            }
            Self::SetLocomotion { id, ref locomotion } => {
                encode_pair(to, code::SET_LOCOMOTION, &id, &**locomotion);
            }
            Self::Jump { id, speed, from } => {
                encode_head(to, code::JUMP, &id);
                to.f32(speed);
                from.encode(to);
            }
            Self::SetWheels { id, ref inputs } => {
                encode_head(to, code::SET_WHEELS, &id);
                encode_each(inputs, to);
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
            code::SET_GRAVITY => Self::SetGravity {
                gravity: vector(from)?,
            },
            code::ADD_JOINT => Self::AddJoint {
                id: JointId::decode(from)?,
                joint: Box::new(Joint::decode(from)?),
            },
            code::REMOVE_JOINT => Self::RemoveJoint {
                id: JointId::decode(from)?,
            },
            code::CHANGE_BODY => Self::ChangeBody {
                desc: BodyDesc::decode(from)?,
            },
            code::CHANGE_JOINT => Self::ChangeJoint {
                id: JointId::decode(from)?,
                joint: Box::new(Joint::decode(from)?),
            },
            code::SLEEP => Self::Sleep {
                id: BodyId::decode(from)?,
            },
            code::WAKE => Self::Wake {
                id: BodyId::decode(from)?,
            },
            code::SET_EVENTS => Self::SetEvents {
                id: BodyId::decode(from)?,
                events: ActiveEvents::decode(from)?,
            },
            moved @ (code::SET_LOCOMOTION | code::JUMP | code::SET_WHEELS) => {
                decode_locomotion(moved, from)?
            }
            push @ (code::FORCE
            | code::TORQUE
            | code::IMPULSE
            | code::TORQUE_IMPULSE
            | code::FORCE_AT
            | code::IMPULSE_AT) => decode_push(push, from)?,
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
