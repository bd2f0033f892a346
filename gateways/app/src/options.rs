//! Options of sending to APP clients, and reasons of refusals.
//!
//! A well-formed message that is refused has no effect.

use core::fmt;

use rhumb_protocol::scene::{CommandError, Invalid};

/// Options of sending to APP clients. The defaults protect the published plug-in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AppOptions {
    /// Transport of the end of a frame.
    pub time_advanced: TimeAdvanced,
    /// Bodies whose state is sent in each frame.
    pub states: States,
    /// Messages per datagram.
    pub datagrams: Datagrams,
}

/// Transport of the end of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TimeAdvanced {
    /// TCP: the message is not lost when a burst of states overflows the client's buffer.
    #[default]
    Tcp,
    /// UDP: the last datagram of a frame, after its states.
    Udp,
    /// None: the published plug-in then keeps no list of received states, and shows a frame time of zero.
    Never,
}

/// Bodies whose state is sent in each frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum States {
    /// Every body that can move.
    All,
    /// Every body that is awake.
    Active,
    /// Every body that has moved since its last sent state; a body that comes to rest is sent again on TCP.
    #[default]
    Changed,
}

/// Messages per datagram.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Datagrams {
    /// One, as the protocol has it: the published plug-in reads only the first.
    #[default]
    Single,
    /// As many as fit 1,472 bytes: to measure the effect of packing alone.
    Packed,
}

/// Reason of a refused message. The client is informed and continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// A number is not finite, or out of range.
    Number,
    /// A shape has invalid numbers.
    Shape(Invalid),
    /// The engine cannot make a solid of the shape.
    UnusableShape,
    /// Too many actors, shapes, joints, or parts of one actor.
    TooMany,
    /// Planes are not supported as shapes.
    Plane,
    /// No joint kind leaves these motions free.
    Joint,
    /// The joint's actor does not exist.
    JointTo(u32),
    /// The frame's time is zero, more than a second, or not expressible in ticks.
    Time,
    /// The scene refuses the command.
    Scene(CommandError),
}

/// A refused message and its actor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RefusedMessage {
    /// Index of the message; if it fails only at the frame, of the last message about the actor.
    pub(super) index: u32,
    /// The actor, if the frame failed at one.
    pub(super) actor: Option<u32>,
    /// The reason.
    pub(super) refusal: Refusal,
}

impl RefusedMessage {
    /// A refusal when the message arrives.
    pub(super) const fn at_once(index: u32, refusal: Refusal) -> Self {
        Self {
            index,
            actor: None,
            refusal,
        }
    }

    /// A refusal of an actor's changes at a frame.
    pub(super) const fn at_frame(index: u32, actor: u32, refusal: Refusal) -> Self {
        Self {
            index,
            actor: Some(actor),
            refusal,
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number => f.write_str("a number is not finite or out of range"),
            Self::Shape(invalid) => write!(f, "the shape is refused: {invalid}"),
            Self::UnusableShape => f.write_str("the engine cannot make a solid of the shape"),
            Self::TooMany => f.write_str("the limit of these is reached"),
            Self::Plane => f.write_str("planes are not supported as shapes"),
            Self::Joint => f.write_str("no joint kind leaves these motions free"),
            Self::JointTo(actor) => write!(f, "the joint's actor {actor} does not exist"),
            Self::Time => f.write_str("a frame must be longer than zero and at most a second"),
            Self::Scene(error) => write!(f, "the scene refuses it: {error}"),
        }
    }
}

impl From<Invalid> for Refusal {
    fn from(invalid: Invalid) -> Self {
        Self::Shape(invalid)
    }
}

impl From<CommandError> for Refusal {
    fn from(error: CommandError) -> Self {
        Self::Scene(error)
    }
}
