//! Allocator of body ids, from granted ranges and from bodies that are gone.
//!
//! Requests nothing from the server. Invariant: no id is allocated twice.

use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

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
}
