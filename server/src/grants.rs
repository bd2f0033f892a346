//! Index ranges of members, for the ids of their bodies.
//!
//! Ranges of former members are granted again once no body lives in them.

use std::collections::BTreeMap;

use rhumb_protocol::Peer;
use rhumb_protocol::limits::{GRANTED_MAX, INDICES_MAX, RANGES_PER_MEMBER_MAX};
use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// Granted indices of one scene.
#[derive(Debug, Default)]
pub(crate) struct Grants {
    end: u32,
    granted: BTreeMap<Peer, Vec<IdRange>>,
    retired: Vec<IdRange>,
}

/// Vacancy of a range: `None` while a body lives in it, otherwise the least unused generation.
pub(crate) type IsVacant<'a> = dyn Fn(&IdRange) -> Option<u16> + 'a;

impl Grants {
    /// Grants a member `count` indices; `None` when no run of that length is left or the member has too many runs.
    pub(crate) fn grant(
        &mut self,
        peer: Peer,
        count: u32,
        vacancy: &IsVacant<'_>,
    ) -> Option<IdRange> {
        let granted = self.granted.get(&peer).map_or(&[][..], Vec::as_slice);
        let indices: u32 = granted.iter().map(IdRange::count).sum();
        if granted.len() >= RANGES_PER_MEMBER_MAX || count > GRANTED_MAX - indices.min(GRANTED_MAX)
        {
            return None;
        }
        let range = self.reuse(count, vacancy).or_else(|| self.extend(count))?;
        self.granted.entry(peer).or_default().push(range);
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

    /// True if a member may use an id.
    pub(crate) fn allows(&self, peer: Peer, id: BodyId) -> bool {
        let ranges = self.granted.get(&peer);
        ranges.is_some_and(|ranges| ranges.iter().any(|range| range.contains(id)))
    }

    /// The member whose range contains an id.
    pub(crate) fn owner(&self, id: BodyId) -> Option<Peer> {
        let mut granted = self.granted.iter();
        let owner = granted.find(|(_, ranges)| ranges.iter().any(|range| range.contains(id)));
        owner.map(|(peer, _)| *peer)
    }

    /// Grants from this index on, in a scene that had members before.
    pub(crate) fn begin_after(&mut self, end: u32) {
        self.end = self.end.max(end);
    }

    /// Gives a member the ranges of its session.
    pub(crate) fn give_back(&mut self, peer: Peer, ranges: Vec<IdRange>) {
        self.granted.insert(peer, ranges);
    }

    /// Takes a member's ranges, which its session keeps.
    pub(crate) fn withdraw(&mut self, peer: Peer) {
        self.granted.remove(&peer);
    }

    /// Frees the ranges of a session that is over.
    pub(crate) fn free(&mut self, ranges: Vec<IdRange>) {
        self.retired.extend(ranges);
    }

    /// The first range of a member.
    pub(crate) fn first(&self, peer: Peer) -> Option<IdRange> {
        self.granted.get(&peer)?.first().copied()
    }

    /// Frees the ranges of a member that left.
    pub(crate) fn retire(&mut self, peer: Peer) {
        self.retired
            .extend(self.granted.remove(&peer).unwrap_or_default());
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::limits::{GRANT, RESERVE_MAX};

    use super::*;

    #[test]
    fn a_range_without_bodies_is_granted_again() {
        let mut grants = Grants::default();
        let (first, second) = (Peer(1), Peer(2));
        let nothing_lives = |_: &IdRange| Some(3);
        let range = grants.grant(first, 10, &nothing_lives).unwrap();
        assert_eq!((range.first(), range.generation()), (0, 0));
        assert!(grants.allows(first, BodyId::new(9, 0)));
        assert!(!grants.allows(first, BodyId::new(10, 0)));
        assert!(!grants.allows(second, BodyId::new(0, 0)));
        assert_eq!(grants.owner(BodyId::new(9, 4)), Some(first));
        grants.retire(first);
        assert_eq!(grants.owner(BodyId::new(9, 4)), None);
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
    fn indices_are_limited() {
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
        // Tables by index are no longer than the member's grant, whichever body it adds.
        assert_eq!(grants.end, GRANTED_MAX);
        assert!(grants.grant(Peer(2), GRANT, &|_| None).is_some());
        // A reused range counts in full.
        grants.retire(Peer(1));
        let nothing_lives = |_: &IdRange| Some(1);
        assert!(grants.grant(Peer(3), RESERVE_MAX, &nothing_lives).is_some());
        let next = grants.grant(Peer(3), GRANT, &nothing_lives);
        assert_eq!(next.map(|range| range.first()), Some(0));
        assert_eq!(grants.grant(Peer(3), 1, &nothing_lives), None);
    }
}
