//! The names of a client's bodies in its scene.
//!
//! Indices are given out from the lowest up, and come again with the next generation once all were used: one that was
//! given back last is used last, so that a watcher sees few bodies under one index.

use std::collections::VecDeque;

use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// Indices of one range, used and free.
#[derive(Debug, Default)]
pub(super) struct Names {
    /// Below it all were used.
    next: u32,
    free: VecDeque<BodyId>,
}

impl Names {
    /// A name that no body had. `None` when the range is used up.
    pub(super) fn take(&mut self, range: &IdRange) -> Option<BodyId> {
        if self.next < range.count() {
            let id = BodyId::new(range.first() + self.next, range.generation());
            self.next += 1;
            return Some(id);
        }
        self.free.pop_front()
    }

    /// A name is free; the index has none any more once its generations are used up.
    pub(super) fn give_back(&mut self, id: BodyId) {
        self.free.extend(Self::again(id));
    }

    /// The next name of the same index.
    pub(super) fn again(id: BodyId) -> Option<BodyId> {
        let generation = id.generation().checked_add(1)?;
        Some(BodyId::new(id.index(), generation))
    }
}
