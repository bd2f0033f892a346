//! Reasons why a well-formed APP message is refused, without any effect.

use core::fmt;

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{CommandError, Invalid};

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
    /// No scene is available.
    NoScene(Denial),
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
            Self::NoScene(denial) => write!(f, "no scene is available: {denial}"),
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
