//! Ids for the bodies of one client, from granted ranges and used again.
//!
//! Requests nothing from the server. Invariants: no id is allocated twice, and an id is done with once.

use rhumb_protocol::scene::{CommandError, IdRange};
use rhumb_reckoning::BodyId;

use crate::unanswered::Unanswered;

/// The ids of one client in one scene.
#[derive(Debug)]
pub(crate) struct IdAllocator {
    ranges: Vec<IdRange>,
    /// Position of the range in use, and the number of its indices that are allocated.
    next: (usize, u32),
    /// For each index of a removed or refused body, the id of the next generation.
    free: Vec<BodyId>,
}

impl IdAllocator {
    pub(crate) fn new(granted: IdRange) -> Self {
        Self {
            ranges: vec![granted],
            next: (0, 0),
            free: Vec::new(),
        }
    }

    /// Adds a range that the server granted.
    pub(crate) fn grant(&mut self, range: IdRange) {
        self.ranges.push(range);
    }

    /// Number of granted indices in all ranges.
    pub(crate) fn granted(&self) -> u32 {
        self.ranges.iter().map(IdRange::count).sum()
    }

    /// Number of ids that can be allocated before another grant.
    pub(crate) fn available(&self) -> u32 {
        let (place, given) = self.next;
        let fresh: u32 = self.ranges[place..].iter().map(IdRange::count).sum();
        fresh - given + self.free.len() as u32
    }

    /// Allocates an id: an unused index while there is one, then the index of a body that is gone.
    pub(crate) fn take(&mut self) -> Option<BodyId> {
        loop {
            let (place, given) = self.next;
            if let Some(id) = self.ranges[place].id(given) {
                self.next.1 += 1;
                return Some(id);
            }
            if place + 1 == self.ranges.len() {
                return self.free.pop();
            }
            self.next = (place + 1, 0);
        }
    }

    /// Frees the index of a removed or refused body for its next generation, if this client was granted the index. The
    /// id of a refused body is not allocated again: commands that name it may be under way.
    pub(crate) fn release(&mut self, id: BodyId) {
        let ours = self.ranges.iter().any(|range| range.contains(id));
        if ours && let Some(generation) = id.generation().checked_add(1) {
            self.free.push(BodyId::new(id.index(), generation));
        }
    }
}

/// The bodies of one client in one scene, from the command that adds each of them.
#[derive(Debug, Default)]
pub(crate) struct OwnBodies {
    by_index: Vec<Option<Addition>>,
    /// Bodies whose addition the server has not answered yet.
    unanswered: Unanswered<BodyId>,
}

/// The command that adds a body.
#[derive(Clone, Copy, Debug)]
struct Addition {
    command: u64,
    generation: u16,
    id_source: IdSource,
}

/// The origin of a body's id.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum IdSource {
    /// The client took it for this body alone.
    Client,
    /// The caller named it, and may add the body again under it. It is done with when such a body is removed.
    Caller,
}

impl OwnBodies {
    /// Stores a body whose addition is queued.
    pub(crate) fn add(&mut self, id: BodyId, command: u64, id_source: IdSource) {
        if id_source == IdSource::Client {
            self.unanswered.insert(command, id);
        }
        if self.get(id).is_some() {
            return;
        }
        let (index, generation) = (id.index() as usize, id.generation());
        if index >= self.by_index.len() {
            self.by_index.resize(index + 1, None);
        }
        self.by_index[index] = Some(Addition {
            command,
            generation,
            id_source,
        });
    }

    /// Handles a refusal; returns the id that is done with. The server never placed its body.
    pub(crate) fn handle_refused(&mut self, command: u64, error: CommandError) -> Option<BodyId> {
        let id = self.unanswered.remove(command)?;
        self.get(id).filter(|known| known.command == command)?;
        self.remove(id);
        // An index that another body has, or that is not this client's, is not this client's to give out.
        let usable = !matches!(
            error,
            CommandError::BodyIdTaken(_) | CommandError::NotGranted(_)
        );
        usable.then_some(id)
    }

    /// Handles the answer to all commands up to this number; returns the ids that are done with. A body that the scene
    /// does not have now was removed, or refused while no connection was there.
    pub(crate) fn handle_applied(
        &mut self,
        through: u64,
        is_gone: impl Fn(BodyId) -> bool,
    ) -> Vec<BodyId> {
        let answered = self.unanswered.take_through(through).into_iter();
        let mut gone: Vec<_> = answered.map(|(_, id)| id).collect();
        gone.retain(|id| is_gone(*id) && self.remove(*id));
        gone
    }

    /// Handles the begin of another connection, over which commands from this number on are sent again; returns the ids
    /// that are done with. No connection carried the removals of their bodies.
    pub(crate) fn handle_resumed(
        &mut self,
        commands: u64,
        is_gone: impl Fn(BodyId) -> bool,
    ) -> Vec<BodyId> {
        let mut gone = Vec::new();
        for (index, addition) in (0..).zip(&self.by_index) {
            let addition = addition.filter(|known| known.id_source == IdSource::Client);
            let Some(addition) = addition else {
                continue;
            };
            let id = BodyId::new(index, addition.generation);
            if addition.command >= commands {
                self.unanswered.insert(addition.command, id);
            } else if !self.unanswered.has(addition.command) && is_gone(id) {
                gone.push(id);
            }
        }
        gone.retain(|id| self.remove(*id));
        gone
    }

    /// Handles the removal of a body; true if its id is done with now.
    pub(crate) fn remove(&mut self, id: BodyId) -> bool {
        let is_known = self.get(id).is_some();
        if is_known {
            self.by_index[id.index() as usize] = None;
        }
        is_known
    }

    fn get(&self, id: BodyId) -> Option<Addition> {
        let addition = *self.by_index.get(id.index() as usize)?;
        addition.filter(|addition| addition.generation == id.generation())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_come_from_each_range_once_and_then_from_removed_bodies() {
        let mut ids = IdAllocator::new(IdRange::new(10, 2, 3).unwrap());
        assert_eq!((ids.available(), ids.granted()), (2, 2));
        assert_eq!(ids.take(), Some(BodyId::new(10, 3)));
        assert_eq!(ids.take(), Some(BodyId::new(11, 3)));
        assert_eq!((ids.take(), ids.available()), (None, 0));
        ids.grant(IdRange::new(40, 1, 0).unwrap());
        ids.release(BodyId::new(10, 3));
        assert_eq!(ids.available(), 2);
        assert_eq!(ids.take(), Some(BodyId::new(40, 0)));
        assert_eq!(ids.take(), Some(BodyId::new(10, 4)));
        assert_eq!((ids.take(), ids.granted()), (None, 3));
    }

    #[test]
    fn the_index_of_another_client_and_one_without_generations_left_are_not_reused() {
        let mut ids = IdAllocator::new(IdRange::new(0, 1, 0).unwrap());
        ids.take();
        ids.release(BodyId::new(5, 0));
        ids.release(BodyId::new(0, u16::MAX));
        assert_eq!(ids.take(), None);
    }

    const ID: BodyId = BodyId::new(3, 0);

    #[test]
    fn an_id_is_done_with_once() {
        let mut bodies = OwnBodies::default();
        bodies.add(ID, 7, IdSource::Client);
        // The engine failed on a command that was applied: the body is removed as well.
        let error = CommandError::EngineFailed;
        assert_eq!(bodies.handle_refused(7, error), Some(ID));
        assert_eq!(bodies.handle_refused(7, error), None);
        assert!(!bodies.remove(ID));
        bodies.add(ID, 8, IdSource::Client);
        assert_eq!(bodies.handle_applied(8, |_| false), []);
        assert_eq!(bodies.handle_refused(8, error), None);
        assert!(bodies.remove(ID));
        assert!(!bodies.remove(ID));
    }

    #[test]
    fn a_body_that_another_connection_finds_gone_is_done_with_unless_it_is_added_again() {
        let mut bodies = OwnBodies::default();
        let ids = [0, 1, 2].map(|index| BodyId::new(index, 0));
        for (id, command) in ids.into_iter().zip(0..) {
            bodies.add(id, command, IdSource::Client);
        }
        assert_eq!(bodies.handle_applied(1, |_| false), []);
        // The scene is restored to a moment before the second body was added.
        assert_eq!(bodies.handle_resumed(1, |_| true), [ids[0]]);
        assert!(!bodies.remove(ids[0]));
        let second = |id| id == ids[1];
        assert_eq!(bodies.handle_applied(2, second), [ids[1]]);
        assert_eq!(bodies.handle_resumed(3, |_| false), []);
        assert!(bodies.remove(ids[2]));
    }

    #[test]
    fn an_id_that_is_taken_or_that_the_caller_named_is_not_done_with() {
        let mut bodies = OwnBodies::default();
        let taken = [
            CommandError::BodyIdTaken(ID),
            CommandError::NotGranted(ID),
            CommandError::TooManyBodies,
        ];
        let id_sources = [IdSource::Client, IdSource::Client, IdSource::Caller];
        for (command, (error, id_source)) in (0..).zip(taken.into_iter().zip(id_sources)) {
            bodies.add(ID, command, id_source);
            assert_eq!(bodies.handle_refused(command, error), None, "{error}");
        }
        // One of two bodies of the id is refused, and the other stays.
        for refused in [5, 6] {
            bodies.add(ID, 5, IdSource::Caller);
            bodies.add(ID, 6, IdSource::Caller);
            let error = CommandError::BodyIdTaken(ID);
            assert_eq!(bodies.handle_refused(refused, error), None);
            assert_eq!(bodies.handle_applied(6, |_| false), []);
            assert!(bodies.remove(ID));
        }
        // It may be added again, although the answer was lost.
        bodies.add(ID, 7, IdSource::Caller);
        assert_eq!(bodies.handle_applied(7, |_| true), []);
        assert_eq!(bodies.handle_resumed(8, |_| true), []);
    }
}
