//! Which member may name bodies with which indices.
//!
//! IndexRanges of members who left are given out again once no body lives in them.

use std::collections::BTreeMap;

use rhumb_protocol::Peer;
use rhumb_protocol::limits::{GRANTED_MAX, INDICES_MAX, RANGES_PER_MEMBER_MAX};
use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// The indices of one scene.
#[derive(Debug, Default)]
pub(crate) struct Grants {
    end: u32,
    held: BTreeMap<Peer, Vec<IdRange>>,
    retired: Vec<IdRange>,
}

/// What the scene knows of a range: `None` while a body lives in it, otherwise the least generation not yet used.
pub(crate) type IsVacant<'a> = dyn Fn(&IdRange) -> Option<u16> + 'a;

impl Grants {
    /// Gives a member `count` indices, or `None` when no run of so many is left or it holds too many runs already.
    pub(crate) fn grant(
        &mut self,
        peer: Peer,
        count: u32,
        vacancy: &IsVacant<'_>,
    ) -> Option<IdRange> {
        let held = self.held.get(&peer).map_or(&[][..], Vec::as_slice);
        let indices: u32 = held.iter().map(IdRange::count).sum();
        if held.len() >= RANGES_PER_MEMBER_MAX || count > GRANTED_MAX - indices.min(GRANTED_MAX) {
            return None;
        }
        let range = self.reuse(count, vacancy).or_else(|| self.extend(count))?;
        self.held.entry(peer).or_default().push(range);
        Some(range)
    }

    fn reuse(&mut self, count: u32, vacancy: &IsVacant<'_>) -> Option<IdRange> {
        let (place, generation) = self.retired.iter().enumerate().find_map(|(place, range)| {
            let generation = (range.count() >= count).then(|| vacancy(range))??;
            Some((place, generation))
        })?;
        let range = self.retired.swap_remove(place);
        IdRange::new(range.first(), range.count(), generation)
    }

    fn extend(&mut self, count: u32) -> Option<IdRange> {
        let left = INDICES_MAX - self.end;
        let range = (count <= left).then(|| IdRange::new(self.end, count, 0))??;
        self.end += count;
        Some(range)
    }

    /// Whether a member may name a body so.
    pub(crate) fn allows(&self, peer: Peer, id: BodyId) -> bool {
        let ranges = self.held.get(&peer);
        ranges.is_some_and(|ranges| ranges.iter().any(|range| range.contains(id)))
    }

    /// Which member may name bodies of this index.
    pub(crate) fn parent_candidate(&self, id: BodyId) -> Option<Peer> {
        let mut held = self.held.iter();
        let parent_candidate =
            held.find(|(_, ranges)| ranges.iter().any(|range| range.contains(id)));
        parent_candidate.map(|(peer, _)| *peer)
    }

    /// The range that a member was given first.
    pub(crate) fn first(&self, peer: Peer) -> Option<IdRange> {
        self.held.get(&peer)?.first().copied()
    }

    /// A member left.
    pub(crate) fn retire(&mut self, peer: Peer) {
        self.retired
            .extend(self.held.remove(&peer).unwrap_or_default());
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::limits::{GRANT, RESERVE_MAX};

    use super::*;

    #[test]
    fn a_range_is_given_out_again_when_nothing_lives_in_it() {
        let mut grants = Grants::default();
        let (first, second) = (Peer(1), Peer(2));
        let nothing_lives = |_: &IdRange| Some(3);
        let range = grants.grant(first, 10, &nothing_lives).unwrap();
        assert_eq!((range.first(), range.generation()), (0, 0));
        assert!(grants.allows(first, BodyId::new(9, 0)));
        assert!(!grants.allows(first, BodyId::new(10, 0)));
        assert!(!grants.allows(second, BodyId::new(0, 0)));
        assert_eq!(grants.parent_candidate(BodyId::new(9, 4)), Some(first));
        grants.retire(first);
        assert_eq!(grants.parent_candidate(BodyId::new(9, 4)), None);
        assert!(!grants.allows(first, BodyId::new(0, 0)));
        let other = grants.grant(second, 10, &|_| None).unwrap();
        assert_eq!(other.first(), 10);
        let again = grants.grant(second, 5, &nothing_lives).unwrap();
        assert_eq!(
            (again.first(), again.count(), again.generation()),
            (0, 10, 3)
        );
    }

    #[test]
    fn there_is_an_end_to_indices() {
        let mut grants = Grants::default();
        let (mut left, mut member) = (INDICES_MAX, 0);
        while left > 0 {
            let count = left.min(GRANTED_MAX);
            assert!(grants.grant(Peer(member), count, &|_| None).is_some());
            (left, member) = (left - count, member + 1);
        }
        assert_eq!(grants.grant(Peer(99), 1, &|_| None), None);
    }

    #[test]
    fn one_member_cannot_take_all_indices() {
        let mut grants = Grants::default();
        assert!(grants.grant(Peer(1), GRANT, &|_| None).is_some());
        assert!(grants.grant(Peer(1), RESERVE_MAX, &|_| None).is_some());
        assert_eq!(grants.grant(Peer(1), 1, &|_| None), None);
        // Tables by index are no longer than what it holds, whichever body it adds.
        assert_eq!(grants.end, GRANTED_MAX);
        assert!(grants.grant(Peer(2), GRANT, &|_| None).is_some());
        // A range that comes again counts as the whole that it is.
        grants.retire(Peer(1));
        let nothing_lives = |_: &IdRange| Some(1);
        assert!(grants.grant(Peer(3), RESERVE_MAX, &nothing_lives).is_some());
        let next = grants.grant(Peer(3), GRANT, &nothing_lives);
        assert_eq!(next.map(|range| range.first()), Some(0));
        assert_eq!(grants.grant(Peer(3), 1, &nothing_lives), None);
    }
}
