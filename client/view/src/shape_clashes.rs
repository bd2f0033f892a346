//! Bodies under a shape number that another client took first.
//!
//! Two clients may give one number to two shapes at once. The server refuses the second shape, and places the bodies
//! behind it with the first one. This part finds those bodies, and `client_ids` mends them: it changes their shapes, or
//! removes bodies that cannot be changed.

use std::collections::VecDeque;

use rhumb_protocol::scene::{BodyDesc, CommandError, Shape, ShapeId};
use rhumb_reckoning::BodyId;

use crate::unanswered::Unanswered;

/// Unanswered commands that rely on the number of a shape.
#[derive(Debug, Default)]
pub(crate) struct ShapeClashes {
    /// Bodies with a shape number of this client's choice.
    bodies: Unanswered<BodyDesc>,
    /// Shapes that were refused because their numbers are taken.
    refused: Unanswered<(ShapeId, Shape)>,
    /// Bodies to mend.
    wrong: VecDeque<WrongBody>,
    /// Commands that mend bodies.
    mends: Unanswered<Mend>,
}

/// A body that has another client's shape.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WrongBody {
    pub(crate) desc: BodyDesc,
    /// The shape that it is to have; `None` if it is to be removed.
    pub(crate) shape: Option<Shape>,
}

/// A command that mends a body.
#[derive(Clone, Copy, Debug)]
enum Mend {
    Changes(BodyDesc),
    Removes,
}

impl ShapeClashes {
    /// Stores a queued command that adds a body.
    pub(crate) fn add(&mut self, desc: BodyDesc, command: u64) {
        self.bodies.insert(command, desc);
    }

    /// Stores a queued command that gives a body its shape after a clash.
    pub(crate) fn add_change(&mut self, desc: BodyDesc, command: u64) {
        self.bodies.insert(command, desc);
        self.mends.insert(command, Mend::Changes(desc));
    }

    /// Stores a queued command that removes a body after a clash.
    pub(crate) fn add_removal(&mut self, command: u64) {
        self.mends.insert(command, Mend::Removes);
    }

    /// Handles a queued change of a body, or its removal: a later mend keeps what the change sets.
    pub(crate) fn note_changed(&mut self, id: BodyId, desc: Option<BodyDesc>) {
        self.bodies.retain_mut(|of_body| {
            if of_body.id != id {
                return true;
            }
            // Of another shape, it is not behind the one that is refused.
            let kept = desc.filter(|desc| desc.shape == of_body.shape);
            *of_body = kept.unwrap_or(*of_body);
            kept.is_some()
        });
    }

    /// Handles the refusal of a shape whose number is taken, perhaps by an equal shape.
    pub(crate) fn handle_taken(&mut self, command: u64, id: ShapeId, shape: Shape) {
        self.refused.insert(command, (id, shape));
    }

    /// Handles the refusal of any command; true if it was to mend a body.
    pub(crate) fn handle_refused(&mut self, command: u64, error: CommandError) -> bool {
        self.bodies.remove(command);
        let mend = self.mends.remove(command);
        if let Some(Mend::Changes(desc)) = mend
            && !matches!(error, CommandError::UnknownBody(_))
        {
            let shape = None;
            self.wrong.push_back(WrongBody { desc, shape });
        }
        mend.is_some()
    }

    /// Handles the answer to all commands up to this number. `known`: the shapes of the scene, with the effects of these
    /// commands.
    pub(crate) fn handle_applied<'a>(
        &mut self,
        through: u64,
        known: impl Fn(ShapeId) -> Option<&'a Shape>,
    ) {
        for (command, (id, shape)) in self.refused.take_through(through) {
            if known(id) == Some(&shape) {
                continue;
            }
            // Also bodies that are still under way: they were queued before the number was known to be taken.
            let behind = self.bodies.from(command).iter().map(|(_, desc)| *desc);
            let wrong = behind.filter(|desc| desc.shape == id);
            self.wrong.extend(wrong.map(|desc| WrongBody {
                desc,
                shape: Some(shape.clone()),
            }));
        }
        self.bodies.take_through(through);
        self.mends.take_through(through);
    }

    /// A body to mend.
    pub(crate) fn next_wrong(&self) -> Option<WrongBody> {
        self.wrong.front().cloned()
    }

    /// Forgets the body that [`Self::next_wrong`] returned.
    pub(crate) fn end_wrong(&mut self) {
        self.wrong.pop_front();
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::BodyKind;

    use super::*;

    #[test]
    fn a_later_change_by_the_application_is_kept_or_ends_the_mending() {
        let mut clashes = ShapeClashes::default();
        let [kept, reshaped, removed] = [0, 1, 2].map(|index| {
            let id = BodyId::new(index, 0);
            BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(3))
        });
        for (desc, command) in [kept, reshaped, removed].into_iter().zip(2..) {
            clashes.add(desc, command);
        }
        clashes.handle_taken(1, ShapeId(3), Shape::ball(0.5));
        let kind = BodyKind::Fixed;
        let kept = BodyDesc { kind, ..kept };
        let shape = ShapeId(4);
        clashes.note_changed(kept.id, Some(kept));
        clashes.note_changed(reshaped.id, Some(BodyDesc { shape, ..reshaped }));
        clashes.note_changed(removed.id, None);
        clashes.handle_applied(9, |_| None);
        assert_eq!(clashes.next_wrong().map(|wrong| wrong.desc), Some(kept));
        clashes.end_wrong();
        assert_eq!(clashes.next_wrong(), None);
    }
}
