//! Body ids that this client may give out: granted ranges, and indices whose bodies are gone.
//!
//! Asks for nothing itself. Invariant: no id is given out twice.

use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// The ids of one client in one scene.
#[derive(Debug)]
pub(crate) struct IdAllocator {
    ranges: Vec<IdRange>,
    /// Place of the range that is being given out, and how many of its indices are.
    next: (usize, u32),
    /// The next id of each index whose body is gone.
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

    /// The server has granted more.
    pub(crate) fn grant(&mut self, range: IdRange) {
        self.ranges.push(range);
    }

    /// How many indices the server has granted in all.
    pub(crate) fn granted(&self) -> u32 {
        self.ranges.iter().map(IdRange::count).sum()
    }

    /// How many ids can be given out before more must be granted.
    pub(crate) fn available(&self) -> u32 {
        let (place, given) = self.next;
        let fresh: u32 = self.ranges[place..].iter().map(IdRange::count).sum();
        fresh - given + self.free.len() as u32
    }

    /// Gives out an id: a new index while there is one, then one whose body is gone.
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

    /// A body is gone. If its index is this client's, another body may have it, under a greater generation.
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
    fn ids_come_from_each_range_once_and_then_from_bodies_that_are_gone() {
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
