//! Why a well-formed message of a client was not done. Nothing of it was.

use core::fmt;

use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{CommandError, Invalid};

/// Why a message was not done. The client is told, and goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    /// A number that is not finite, or is none.
    Number,
    /// A shape with numbers that no engine should be given.
    Shape(Invalid),
    /// A shape of which the engine can make no solid.
    UnusableShape,
    /// More actors, shapes, joints, or parts of one actor, than there may be.
    TooMany,
    /// Planes are no shapes here.
    Plane,
    /// A joint that leaves other motions free than any that there are.
    Joint,
    /// A joint to an actor that there is not.
    JointTo(u32),
    /// A frame of no time, of more than a second, or of none that makes ticks.
    Time,
    /// The scene refuses it.
    Scene(CommandError),
    /// No scene can be had.
    NoScene(Denial),
}

/// What was not done, and what it was about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RefusedMessage {
    /// The index of its message; of what fails only at a frame, of the last message that was about it.
    pub(super) index: u32,
    /// The actor, where a frame failed at one.
    pub(super) actor: Option<u32>,
    /// Why.
    pub(super) refusal: Refusal,
}

impl RefusedMessage {
    /// A message, when it was heard.
    pub(super) const fn at_once(index: u32, refusal: Refusal) -> Self {
        Self {
            index,
            actor: None,
            refusal,
        }
    }

    /// What became of an actor, at a frame.
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
            Self::UnusableShape => f.write_str("the engine can make no solid of the shape"),
            Self::TooMany => f.write_str("there are as many of these as there may be"),
            Self::Plane => f.write_str("a plane is no shape here"),
            Self::Joint => f.write_str("no joint leaves just these motions free"),
            Self::JointTo(actor) => write!(f, "a joint holds actor {actor}, which there is not"),
            Self::Time => f.write_str("a frame is longer than nothing and at most a second"),
            Self::Scene(error) => write!(f, "the scene refuses it: {error}"),
            Self::NoScene(denial) => write!(f, "there is no scene for it: {denial}"),
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
