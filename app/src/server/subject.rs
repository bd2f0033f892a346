//! The subject of a datagram: a newer one about it replaces one that waits.

use crate::wire::Message;

/// The subject of a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum DatagramSubject {
    /// The state of an actor.
    Actor(u32),
    /// A contact of two actors.
    Pair(u32, u32),
}

/// Order of waiting datagrams: the least first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// The state of an actor that rests, which no later one would correct.
    Resting,
    /// Everything else.
    #[default]
    Moving,
}

impl DatagramSubject {
    /// The subject of a message; `None` for one that no newer one replaces.
    pub(super) const fn of(message: &Message) -> Option<Self> {
        match message {
            Message::SetDynamicActor(motion) => Some(Self::Actor(motion.actor.object)),
            Message::ActorsCollided(contact) => Some(Self::Pair(
                contact.colliding.object,
                contact.collided.object,
            )),
            _ => None,
        }
    }
}

impl Urgency {
    /// The urgency of a message.
    pub(super) fn of(message: &Message) -> Self {
        match message {
            // An engine puts a body to sleep with no velocity at all.
            Message::SetDynamicActor(motion)
                if motion.linear == glam::Vec3::ZERO && motion.angular == glam::Vec3::ZERO =>
            {
                Self::Resting
            }
            _ => Self::Moving,
        }
    }
}
