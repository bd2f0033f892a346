//! Everything that was done to a scene since a moment, in memory.
//!
//! Kept for [`crate::rollback`], which does it again on a copy of the scene as it was then.

use std::collections::BTreeMap;

use rhumb_protocol::Peer;
use rhumb_protocol::scene::{Command, ShapeId};

use crate::permit::ClientName;

/// One change of a scene.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum LogEntry {
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

/// Bytes beyond which a history is given up: a scene of which no copy can be made would fill the memory.
const BYTES_MAX: usize = 16 << 20;

/// The changes in their order.
#[derive(Clone, Debug, Default)]
pub(crate) struct History {
    pub(crate) done: Vec<LogEntry>,
    /// About the bytes that it takes in memory beside the scene.
    bytes: usize,
    /// Bytes of the added shapes that the scene still has.
    shapes: BTreeMap<ShapeId, usize>,
}

impl History {
    /// A history that begins with these changes.
    pub(crate) fn of(done: Vec<LogEntry>) -> Self {
        let mut history = Self::default();
        for change in done {
            history.push(change);
        }
        history
    }

    fn push(&mut self, change: LogEntry) {
        self.bytes += size_of::<LogEntry>();
        if let LogEntry::Applied(command, _) = &change {
            self.bytes += size_of::<Command>();
            match &**command {
                // While the scene has the shape, both share its memory.
                Command::AddShape { id, shape } => {
                    self.shapes.insert(*id, shape.bytes());
                }
                Command::RemoveShape { id } => self.bytes += self.shapes.remove(id).unwrap_or(0),
                _ => {}
            }
        }
        self.done.push(change);
    }

    /// Names the author of the last command.
    pub(super) fn attribute(&mut self, author: Author) {
        if let Some(LogEntry::Applied(_, of)) = self.done.last_mut() {
            *of = Some(Box::new(author));
        }
    }

    /// The history with one more change; `None` if it has become too long to keep.
    pub(super) fn with(mut self, change: LogEntry) -> Option<Self> {
        self.push(change);
        (self.bytes <= BYTES_MAX).then_some(self)
    }

    pub(crate) const fn bytes(&self) -> usize {
        self.bytes
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::{Heights, SceneConfig, Shape};

    use super::*;
    use crate::scene::Scene;

    /// A lockstep scene that no client advances can never be copied, so that its history would grow for ever.
    #[test]
    fn a_history_of_a_scene_that_never_steps_is_bounded() {
        let mut scene = Scene::new(SceneConfig::default()).expect("the default config is valid");
        scene.keep_history(History::default());
        let posts = vec![0.0; 512 * 512];
        let heights = Heights::new(512, 1.0, 1.0, &posts).expect("within the limits");
        let (id, shape) = (ShapeId(0), Shape::Heights(heights));
        let mut longest = 0;
        for _ in 0..40 {
            let shape = shape.clone();
            for command in [Command::AddShape { id, shape }, Command::RemoveShape { id }] {
                scene.apply(&command).expect("the shape is free");
                longest = longest.max(scene.history().map_or(0, History::bytes));
            }
        }
        assert!(longest > BYTES_MAX / 2, "{longest}");
        assert!(longest <= BYTES_MAX, "{longest}");
        assert!(scene.history().is_none(), "a copy begins it anew");
    }
}
