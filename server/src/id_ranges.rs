//! Index ranges of members, for the ids of their bodies.
//!
//! Indices of former members are granted again one by one: a body that lives keeps its own index and no other.
//! Invariants: no index is in two ranges, and a range beyond the first of each member leaves vacant indices for the
//! members that may still join.

use std::collections::BTreeMap;

use rhumb_protocol::limits::{GRANT, GRANTED_MAX, RANGES_PER_MEMBER_MAX, RESERVE_MAX};
use rhumb_protocol::scene::IdRange;
use rhumb_reckoning::BodyId;

/// The free indices of one scene. Members and sessions hold their own ranges.
#[derive(Debug, Default)]
pub(crate) struct IdRanges {
    /// No index from here on was ever granted.
    end: u32,
    /// Runs of indices below `end` that no member has: the first one, and their number. No two runs touch.
    free: BTreeMap<u32, u32>,
}

/// Bounds on the indices of a scene.
#[derive(Clone, Copy, Debug)]
pub(crate) struct IndexLimits {
    /// All new indices are below it: tables by index are no longer.
    pub(crate) indices: u32,
    /// Members that may still join.
    pub(crate) members: u32,
    /// Indices of each new member, at most [`GRANT`].
    pub(crate) share: u32,
}

impl IndexLimits {
    /// The bounds of a scene with so many indices, for at most `members_max` members, of which `members` are there.
    ///
    /// Each member has a share. A third is left for reservations, but no more than one member may ask for.
    pub(crate) fn of(indices: u64, members_max: u64, members: u64) -> Self {
        let shared = indices - (indices / 3).min(RESERVE_MAX.into());
        let share = shared / members_max.max(1);
        Self {
            indices: indices as u32,
            members: members_max.saturating_sub(members) as u32,
            share: share.clamp(1, GRANT.into()) as u32,
        }
    }
}

/// True if an id is in one of these ranges.
pub(crate) fn has(ranges: &[IdRange], id: BodyId) -> bool {
    ranges.iter().any(|range| range.contains(id))
}

/// Vacancy of an index: `None` while a body lives there, or if its generations are used up; otherwise the least unused
/// generation.
pub(crate) type Vacancy<'a> = dyn Fn(u32) -> Option<u16> + 'a;

/// Consecutive vacant indices.
#[derive(Clone, Copy, Debug, Default)]
struct VacantRun {
    first: u32,
    count: u32,
    generation: u16,
}

impl IdRanges {
    /// Grants a new member its first range: its share of the indices, or the longest run if none is so long. `None` when
    /// that has fewer than `least`.
    pub(crate) fn admit(
        &mut self,
        least: u32,
        limits: IndexLimits,
        vacancy: &Vacancy<'_>,
    ) -> Option<IdRange> {
        let fresh = self.fresh(limits);
        let share = limits.share;
        let run = match self.reuse(share, vacancy) {
            run if run.count >= share => run,
            _ if fresh.count >= share => fresh,
            run if run.count >= fresh.count => run,
            _ => fresh,
        };
        (run.count >= least).then(|| self.take(run, share))?
    }

    /// Grants a member `count` further indices, beside those that it has. `None` when no run of that length is left, when later members would
    /// find too few, or when the member has too many.
    pub(crate) fn reserve(
        &mut self,
        granted: &[IdRange],
        count: u32,
        limits: IndexLimits,
        vacancy: &Vacancy<'_>,
    ) -> Option<IdRange> {
        let indices: u32 = granted.iter().map(IdRange::count).sum();
        let fresh = self.fresh(limits);
        if granted.len() >= RANGES_PER_MEMBER_MAX
            || count > GRANTED_MAX - indices.min(GRANTED_MAX)
            || !self.has_left(
                count.saturating_add(limits.share.saturating_mul(limits.members)),
                fresh.count,
                vacancy,
            )
        {
            return None;
        }
        let again = self.reuse(count, vacancy);
        let run = if again.count < count { fresh } else { again };
        (run.count >= count).then(|| self.take(run, count))?
    }

    /// The indices that were never granted.
    fn fresh(&self, limits: IndexLimits) -> VacantRun {
        VacantRun {
            first: self.end,
            count: limits.indices.saturating_sub(self.end),
            generation: 0,
        }
    }

    /// True if at least `count` indices are vacant, `fresh` of which were never granted.
    fn has_left(&self, count: u32, fresh: u32, vacancy: &Vacancy<'_>) -> bool {
        let Some(wanted) = count.checked_sub(fresh).filter(|wanted| *wanted > 0) else {
            return true;
        };
        let runs = self.free.iter();
        let indices = runs.flat_map(|(first, length)| *first..first + length);
        let vacant = indices.filter(|index| vacancy(*index).is_some());
        vacant.take(wanted as usize).count() == wanted as usize
    }

    /// The first free run of `count` vacant indices; otherwise the longest.
    fn reuse(&self, count: u32, vacancy: &Vacancy<'_>) -> VacantRun {
        let mut longest = VacantRun::default();
        for (first, length) in &self.free {
            let mut run = VacantRun::default();
            for index in *first..first + length {
                let Some(generation) = vacancy(index) else {
                    run = VacantRun::default();
                    continue;
                };
                if run.count == 0 {
                    run.first = index;
                }
                run.count += 1;
                run.generation = run.generation.max(generation);
                if run.count > longest.count {
                    longest = run;
                }
                if longest.count >= count {
                    return longest;
                }
            }
        }
        longest
    }

    /// Grants the first `count` indices of a run, or all of them if it has fewer.
    fn take(&mut self, run: VacantRun, count: u32) -> Option<IdRange> {
        let count = run.count.min(count);
        let range = (count > 0).then(|| IdRange::new(run.first, count, run.generation))??;
        let after = run.first + count;
        if run.first >= self.end {
            self.end = after;
        } else if let Some((first, length)) = self.free.range(..=run.first).next_back() {
            let (first, end) = (*first, *first + *length);
            self.free.remove(&first);
            self.insert_free(first, run.first);
            self.insert_free(after, end);
        }
        Some(range)
    }

    fn insert_free(&mut self, first: u32, end: u32) {
        if first < end {
            self.free.insert(first, end - first);
        }
    }

    /// Grants indices from this one on, in a scene whose script has those before it.
    pub(crate) fn begin_after(&mut self, end: u32) {
        self.end = self.end.max(end);
    }

    /// Begins in a scene that had members before: sessions keep these ranges, and the other indices before `end` are
    /// free.
    pub(crate) fn restore(&mut self, end: u32, kept: impl IntoIterator<Item = IdRange>) {
        let mut kept: Vec<_> = kept.into_iter().collect();
        kept.sort_by_key(IdRange::first);
        let mut next = self.end;
        for range in kept {
            self.insert_free(next, range.first());
            next = next.max(range.first() + range.count());
        }
        self.insert_free(next, end);
        self.end = next.max(end);
    }

    /// Frees the ranges of a member that left, or of a session that is over.
    pub(crate) fn free(&mut self, ranges: Vec<IdRange>) {
        for range in ranges {
            let (mut first, mut end) = (range.first(), range.first() + range.count());
            if let Some(length) = self.free.remove(&end) {
                end += length;
            }
            if let Some((before, length)) = self.free.range(..first).next_back()
                && before + length == first
            {
                first = *before;
            }
            self.insert_free(first, end);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    const LIMITS: IndexLimits = IndexLimits {
        indices: 1 << 20,
        members: 0,
        share: GRANT,
    };

    fn nothing_lives(_: u32) -> Option<u16> {
        Some(3)
    }

    #[test]
    fn indices_without_bodies_are_granted_again() {
        let mut grants = IdRanges::default();
        let range = grants.admit(1, LIMITS, &nothing_lives).unwrap();
        assert_eq!(
            (range.first(), range.count(), range.generation()),
            (0, GRANT, 0)
        );
        assert!(has(&[range], BodyId::new(GRANT - 1, 0)));
        assert!(!has(&[range], BodyId::new(GRANT, 0)));
        grants.free(vec![range]);
        let mut second = Vec::new();
        let mut reserve = |count, vacancy: &Vacancy<'_>| {
            let range = grants.reserve(&second, count, LIMITS, vacancy).unwrap();
            second.push(range);
            range
        };
        // One body lives: the indices around it are free.
        let vacancy = |index| (index != 9).then_some(3);
        let again = reserve(5, &vacancy);
        assert_eq!(
            (again.first(), again.count(), again.generation()),
            (0, 5, 3)
        );
        let again = reserve(5, &vacancy);
        assert_eq!((again.first(), again.count()), (10, 5));
        let again = reserve(4, &vacancy);
        assert_eq!((again.first(), again.count()), (5, 4));
        let fresh = reserve(GRANT, &vacancy);
        assert_eq!((fresh.first(), fresh.generation()), (GRANT, 0));
    }

    #[test]
    fn a_new_member_gets_the_longest_run_if_none_suffices() {
        let mut grants = IdRanges::default();
        let limits = IndexLimits {
            indices: GRANT + 7,
            ..LIMITS
        };
        let first = grants.admit(1, limits, &nothing_lives).unwrap();
        let rest = grants.admit(1, limits, &nothing_lives).unwrap();
        assert_eq!((rest.first(), rest.count()), (GRANT, 7));
        assert_eq!(grants.admit(1, limits, &nothing_lives), None);
        grants.free(vec![first]);
        let vacancy = |index| (index % 100 != 50).then_some(0);
        let longest = grants.admit(1, limits, &vacancy).unwrap();
        assert_eq!((longest.first(), longest.count()), (51, 99));
    }

    #[test]
    fn one_member_takes_no_more_than_its_part_and_none_of_those_to_come() {
        let mut grants = IdRanges::default();
        let limits = IndexLimits {
            indices: 3 * GRANTED_MAX,
            members: 3,
            share: GRANT,
        };
        let mut members = [const { Vec::new() }; 5];
        let mut reserve = |member: usize, count| {
            let of: &mut Vec<_> = &mut members[member];
            let granted = grants.reserve(of, count, limits, &nothing_lives);
            of.extend(granted);
            granted.is_some()
        };
        assert!(reserve(1, RESERVE_MAX) && reserve(1, GRANT));
        assert!(!reserve(1, 1), "one member");
        assert!(reserve(2, RESERVE_MAX));
        assert!(!reserve(3, RESERVE_MAX), "three more members may come");
        let left = 3 * GRANTED_MAX - 2 * RESERVE_MAX - GRANT;
        assert!(reserve(3, left - 3 * GRANT));
        assert!(!reserve(4, 1));
        for _ in 5..8 {
            let granted = grants.admit(1, limits, &nothing_lives);
            assert_eq!(granted.map(|range| range.count()), Some(GRANT));
        }
        assert_eq!(grants.admit(1, limits, &nothing_lives), None);
    }

    #[test]
    fn each_member_that_a_scene_admits_finds_its_share() {
        for (indices, members_max) in [
            (393_216, 64),
            (393_216, 256),
            (4_096, 64),
            (4_096, 4_096),
            (1 << 20, 1),
        ] {
            let mut grants = IdRanges::default();
            for members in 0..members_max {
                let limits = IndexLimits::of(indices, members_max, members);
                let share = limits.share;
                let granted = grants.admit(share, limits, &nothing_lives);
                assert!(granted.is_some(), "{members} of {members_max}: {share}");
            }
        }
        let default = IndexLimits::of(393_216, 64, 0);
        assert_eq!(default.share, GRANT);
        let mut grants = IdRanges::default();
        let largest = grants.reserve(&[], RESERVE_MAX, default, &nothing_lives);
        assert!(largest.is_some(), "beside the shares of all");
    }

    #[test]
    fn a_restored_scene_has_free_indices_around_those_of_sessions() {
        let mut grants = IdRanges::default();
        let range = |first, count| IdRange::new(first, count, 0).unwrap();
        grants.restore(1_000, [range(500, 10), range(100, 10)]);
        assert_eq!(grants.free, [(0, 100), (110, 390), (510, 490)].into());
        grants.free(vec![range(100, 10)]);
        assert_eq!(grants.free, [(0, 500), (510, 490)].into());
        grants.free(vec![range(500, 10)]);
        assert_eq!((&grants.free, grants.end), (&[(0, 1_000)].into(), 1_000));
    }

    proptest! {
        /// Members come, reserve, leave some bodies behind and go, in any order.
        #[test]
        fn no_index_is_in_two_ranges_or_granted_while_its_body_lives(
            script in prop::collection::vec((0_u32..5, 0_usize..6, 1_u32..6_000), 1..80)
        ) {
            let mut grants = IdRanges::default();
            let mut members = [const { Vec::<IdRange>::new() }; 6];
            let mut living = BTreeSet::new();
            let limits = IndexLimits { indices: 30_000, ..LIMITS };
            for (what, member, number) in script {
                let ranges = &mut members[member];
                let vacancy = |index: u32| (!living.contains(&index)).then_some(0);
                match what {
                    0 if ranges.is_empty() => ranges.extend(grants.admit(1, limits, &vacancy)),
                    1 => ranges.extend(grants.reserve(ranges, number, limits, &vacancy)),
                    2 => grants.free(std::mem::take(ranges)),
                    3 => drop(living.pop_first()),
                    _ => {
                        let of = |range: &IdRange| range.first() + number % range.count();
                        living.extend(ranges.iter().map(of));
                    }
                }
                let mut runs: Vec<_> = grants.free.iter().map(|(a, n)| (*a, *n)).collect();
                let granted = members.iter().flatten();
                runs.extend(granted.map(|range| (range.first(), range.count())));
                runs.sort_unstable();
                let mut next = 0;
                for (first, count) in runs {
                    prop_assert_eq!(first, next);
                    next += count;
                }
                prop_assert_eq!(next, grants.end);
                prop_assert!(next <= limits.indices);
            }
        }
    }
}
