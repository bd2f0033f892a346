//! Everything that was done to a scene since a moment, in memory.
//!
//! Kept for [`crate::rewind`], which does it again on a copy of the scene as it was then.

use rhumb_protocol::Peer;
use rhumb_protocol::scene::Command;

use crate::access::ClientName;

/// One change of a scene.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Done {
    /// A command was applied, whatever its source.
    Applied(Box<Command>, Option<Box<Author>>),
    /// The scene stepped.
    Stepped,
}

/// The member whose command it was.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Author {
    pub(crate) member: Peer,
    /// The member's number of the command.
    pub(crate) number: u64,
    pub(crate) client: Option<ClientName>,
}

/// The changes in their order.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    pub(crate) done: Vec<Done>,
    /// About the bytes that it takes in memory.
    bytes: usize,
}

impl History {
    /// A history that begins with these changes.
    pub(crate) fn of(done: Vec<Done>) -> Self {
        let mut history = Self::default();
        for change in done {
            history.push(change);
        }
        history
    }

    pub(super) fn push(&mut self, change: Done) {
        self.bytes += size_of::<Done>();
        if let Done::Applied(command, _) = &change {
            self.bytes += size_of::<Command>();
            if let Command::AddShape { shape, .. } = &**command {
                self.bytes += shape.bytes();
            }
        }
        self.done.push(change);
    }

    /// Names the author of the last command.
    pub(super) fn attribute(&mut self, author: Author) {
        if let Some(Done::Applied(_, of)) = self.done.last_mut() {
            *of = Some(Box::new(author));
        }
    }

    pub(crate) const fn bytes(&self) -> usize {
        self.bytes
    }
}
