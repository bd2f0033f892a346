//! The bodies that a client knows: its own, and those that it saw come or go.

use rhumb_client::BodyId;

use crate::event_record::EventRecord;
use crate::generated::EventKind;

/// By index: one more than the latest generation, or zero.
#[derive(Debug, Default)]
pub(crate) struct KnownBodies(Vec<u32>);

impl KnownBodies {
    /// Adds a body, and those before it under its index.
    pub(crate) fn add(&mut self, body: BodyId) {
        let place = body.index() as usize;
        if place >= self.0.len() {
            self.0.resize(place + 1, 0);
        }
        self.0[place] = self.0[place].max(u32::from(body.generation()) + 1);
    }

    /// Learns from an event.
    pub(crate) fn note(&mut self, event: &EventRecord) {
        if let (EventKind::BodyPlaced | EventKind::BodyRemoved, Some(body)) =
            (event.kind, event.body)
        {
            self.add(body);
        }
    }

    /// True for a body that was added.
    pub(crate) fn has(&self, body: BodyId) -> bool {
        let latest = self.0.get(body.index() as usize);
        latest.is_some_and(|latest| u32::from(body.generation()) < *latest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_body_is_known_with_those_before_it_and_not_with_later_ones() {
        let mut known = KnownBodies::default();
        known.add(BodyId::new(3, 1));
        let has = |index, generation| known.has(BodyId::new(index, generation));
        assert_eq!([has(3, 0), has(3, 1), has(3, 2)], [true, true, false]);
        assert_eq!([has(0, 0), has(4, 0)], [false, false]);
    }
}
