//! Body ids of an APP client in its scene.
//!
//! Indices are assigned from the lowest up, and reused with the next generation once all were used. The index returned
//! last is reused last, so that subscribers see few bodies under one index.

use std::collections::VecDeque;

use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// Used and free indices of one range.
#[derive(Debug, Default)]
pub(super) struct BodyIds {
    /// `None` until the client's scene begins.
    range: Option<IdRange>,
    /// Every index below it was used.
    next: u32,
    free: VecDeque<BodyId>,
}

impl BodyIds {
    /// Ids of this range.
    pub(super) fn of_range(range: IdRange) -> Self {
        Self {
            range: Some(range),
            ..Self::default()
        }
    }

    /// An id that no body had. `None` when the range is used up.
    pub(super) fn take(&mut self) -> Option<BodyId> {
        let range = self.range?;
        if self.next < range.count() {
            let id = BodyId::new(range.first() + self.next, range.generation());
            self.next += 1;
            return Some(id);
        }
        self.free.pop_front()
    }

    /// Returns an id; an index whose generations are used up is not assigned again.
    pub(super) fn give_back(&mut self, id: BodyId) {
        self.free.extend(Self::again(id));
    }

    /// The next id of the same index.
    pub(super) fn again(id: BodyId) -> Option<BodyId> {
        let generation = id.generation().checked_add(1)?;
        Some(BodyId::new(id.index(), generation))
    }
}
