//! Which body sits where: small numbers for those that are much spoken of.
//!
//! Both ends keep assignments. The publisher decides, and says each assignment; a listener that missed one finds the alias
//! empty or its body's track of another age, and never takes one body for another (PROTOCOL 6.13). While something is
//! missing it remembers who sat where, within a bound beyond which it knows of nobody.

use alloc::collections::{BTreeSet, BinaryHeap};
use alloc::vec::Vec;
use core::cmp::Reverse;
use core::num::NonZeroU32;

use rhumb_reckoning::Tick;

use crate::capacity::grow_to;
use crate::limits::ALIAS_CHANGES_KEPT;

/// Who sits where, and of each alias something more.
#[derive(Clone, Debug, Default)]
pub(crate) struct AliasMap<T> {
    /// By alias, one more than the index of its body.
    aliases: Vec<(Option<NonZeroU32>, T)>,
    /// By index, one more than the alias; 0 for none.
    of_body: Vec<u32>,
}

impl<T: Clone + Default> AliasMap<T> {
    /// The body in a alias.
    pub(crate) fn body(&self, alias: u32) -> Option<u32> {
        let (body, _) = self.aliases.get(alias as usize)?;
        Some((*body)?.get() - 1)
    }

    /// The alias of a body.
    pub(crate) fn of(&self, body: u32) -> Option<u32> {
        self.of_body.get(body as usize)?.checked_sub(1)
    }

    /// A body takes a alias; who sat there stands.
    fn put(&mut self, alias: u32, body: u32, more: T) {
        let place = alias as usize;
        grow_to(&mut self.aliases, place + 1, || (None, T::default()));
        grow_to(&mut self.of_body, body as usize + 1, || 0);
        self.release(body);
        if let Some(before) = self.body(alias) {
            self.of_body[before as usize] = 0;
        }
        self.aliases[place] = (NonZeroU32::new(body + 1), more);
        self.of_body[body as usize] = alias + 1;
    }

    /// Who sits there stands, and nobody takes the alias.
    fn empty(&mut self, alias: u32, more: T) {
        let place = alias as usize;
        grow_to(&mut self.aliases, place + 1, || (None, T::default()));
        if let Some(before) = self.body(alias) {
            self.of_body[before as usize] = 0;
        }
        self.aliases[place] = (None, more);
    }

    /// A body leaves its alias, if it has one; returns which.
    pub(crate) fn release(&mut self, body: u32) -> Option<u32> {
        let alias = self.of(body)?;
        self.of_body[body as usize] = 0;
        self.aliases[alias as usize].0 = None;
        Some(alias)
    }
}

/// A tick in two words: in one it would make room for nothing beside it.
#[derive(Clone, Copy, Debug, Default)]
struct PackedTick([u32; 2]);

impl PackedTick {
    const fn of(tick: Tick) -> Self {
        Self([tick.value() as u32, (tick.value() >> 32) as u32])
    }

    const fn tick(self) -> Tick {
        let Self([low, high]) = self;
        Tick::new(low as u64 | (high as u64) << 32)
    }
}

/// What is known of a body that is said to sit somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AliasOwner {
    /// Nothing that is newer.
    AsAssigned,
    /// It was heard of since, or is not there any more.
    MovedOn,
}

/// From this tick on a body sat in a alias, or nobody that is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct AliasChange {
    alias: u32,
    body: Option<u32>,
    since: Tick,
}

/// The aliases as a listener knows them: with when each was said.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReceivedAliases {
    now: AliasMap<PackedTick>,
    /// Who sat where while packets are missing that may name them so, as it was heard: of one tick the last counts.
    changes: Vec<AliasChange>,
    remembers: bool,
    /// More was heard than is kept, so that nothing is known of before.
    overflowed: bool,
    /// The newest tick of which a refresh told: who sat where before it may have been said in what it stands for.
    refreshed: Tick,
}

impl ReceivedAliases {
    /// The body that sits in a alias since a tick or earlier, if that is known.
    pub(crate) fn body_since(&self, alias: u32, tick: Tick) -> Option<u32> {
        self.now.body(alias).filter(|_| self.since(alias) <= tick)
    }

    /// The body that sat in a alias at a tick and does no more, if that is known. It is not while anything is missing that was
    /// said before that tick.
    pub(crate) fn body_then(&self, alias: u32, tick: Tick) -> Option<u32> {
        if tick < self.refreshed || self.overflowed {
            return None;
        }
        let by_then = || self.changes.iter().filter(|change| change.since <= tick);
        let here = by_then().filter(|change| change.alias == alias);
        let last = here.max_by_key(|change| change.since)?;
        let went = |other: &AliasChange| other.body == last.body && other.since > last.since;
        last.body.filter(|_| !by_then().any(went))
    }

    /// Something is missing: who sits where is remembered from now on.
    pub(crate) const fn remember(&mut self) {
        self.remembers = true;
    }

    /// Nothing is missing any more.
    pub(crate) fn forget(&mut self) {
        self.changes.clear();
        (self.remembers, self.overflowed) = (false, false);
    }

    /// Something was made good by what its bodies do at this tick.
    pub(crate) fn refresh(&mut self, as_of: Tick) {
        self.refreshed = self.refreshed.max(as_of);
    }

    fn note(&mut self, alias: u32, body: Option<u32>, since: Tick) {
        if !self.remembers || self.overflowed {
            return;
        }
        // What was noted last of its alias and tick is not noted again (PROTOCOL 6.13-15).
        let mut newest_first = self.changes.iter().rev();
        let last = newest_first.find(|change| change.alias == alias && change.since == since);
        if last.is_some_and(|change| change.body == body) {
            return;
        }
        if self.changes.len() < ALIAS_CHANGES_KEPT {
            self.changes.push(AliasChange { alias, body, since });
        } else {
            self.overflowed = true;
        }
    }

    /// Who sits in a alias will do so no longer.
    fn note_owner(&mut self, alias: u32) {
        if let Some(body) = self.now.body(alias) {
            self.note(alias, Some(body), self.since(alias));
        }
    }

    /// A body takes a alias; who sat there stands. What was said later of either stays.
    ///
    /// Who has gone on since takes none: where it sits now was said with what was heard later. Then who sits there is not
    /// known, unless it is this body still.
    pub(crate) fn take(&mut self, alias: u32, body: u32, tick: Tick, owner: AliasOwner) {
        let later = |alias: u32| self.since(alias) > tick;
        let (gone_on, had) = (owner == AliasOwner::MovedOn, self.now.of(body));
        let (taken, moved) = (later(alias), had.is_some_and(later));
        self.note(alias, Some(body), tick);
        if taken || (gone_on && had == Some(alias)) {
            return;
        }
        self.note_owner(alias);
        if gone_on || moved {
            self.now.empty(alias, PackedTick::of(tick));
        } else {
            if let Some(had) = had {
                self.note_owner(had);
            }
            self.now.put(alias, body, PackedTick::of(tick));
        }
    }

    /// A body leaves its alias after this tick, if it has one.
    pub(crate) fn release(&mut self, body: u32, tick: Tick) {
        if let Some(alias) = self.now.of(body) {
            self.note_owner(alias);
            self.note(alias, None, tick.next());
            self.now.release(body);
        }
    }

    /// A body is another one now, or another one than was predicted_motion: where it sat is not known.
    pub(crate) fn clear(&mut self, body: u32) {
        self.now.release(body);
        for change in &mut self.changes {
            change.body = change.body.filter(|other| *other != body);
        }
    }

    /// A body had no alias at a tick; one that it took later stays.
    pub(crate) fn release_by(&mut self, body: u32, tick: Tick) {
        if let Some(alias) = self.now.of(body)
            && self.since(alias) <= tick
        {
            self.note_owner(alias);
            self.note(alias, None, tick);
            self.now.release(body);
        }
    }

    /// When a alias was taken last.
    fn since(&self, alias: u32) -> Tick {
        let alias = self.now.aliases.get(alias as usize);
        alias.map_or(Tick::ZERO, |(_, since)| since.tick())
    }
}

/// Gives aliases out: the lowest that is free.
///
/// ReceivedAliases that were left cost nothing, however many were taken once: it is looked where somebody sits.
#[derive(Clone, Debug, Default)]
pub(crate) struct AliasTable {
    /// With the low bits of the tick at which its body was last spoken of.
    aliases: AliasMap<u32>,
    free: BinaryHeap<Reverse<u32>>,
    /// Left since the last release_idle_aliases: not given out before the next, so that no two bodies sit there in one tick.
    left: Vec<u32>,
    /// ReceivedAliases from here on were never taken.
    end: u32,
    /// Where it is looked for who is silent: blocks of aliases in which somebody sits, or sat at the last look.
    blocks: BTreeSet<u32>,
    swept: Tick,
}

/// Who was silent for so many ticks loses its alias when others need one.
const ALIAS_IDLE_TICKS: u64 = 60;
/// ReceivedAliases are looked at by so many: a list of them takes little room beside them.
const BLOCK: u32 = 64;

impl AliasTable {
    /// The aliases as they are.
    pub(crate) const fn aliases(&self) -> &AliasMap<u32> {
        &self.aliases
    }

    /// The alias of a body that is spoken of, and whether it takes it now.
    pub(crate) fn alias(&mut self, body: u32, tick: Tick) -> (u32, bool) {
        if let Some(alias) = self.aliases.of(body) {
            self.aliases.aliases[alias as usize].1 = tick.value() as u32;
            return (alias, false);
        }
        let alias = self.free.pop().map_or_else(
            || {
                self.end += 1;
                self.end - 1
            },
            |Reverse(alias)| alias,
        );
        self.blocks.insert(alias / BLOCK);
        self.aliases.put(alias, body, tick.value() as u32);
        (alias, true)
    }

    /// A body comes to rest or goes; its alias is free from the next tick on.
    pub(crate) fn release(&mut self, body: u32) {
        if let Some(alias) = self.aliases.release(body) {
            self.left.push(alias);
        }
    }

    /// Frees the aliases of those who were silent for long; to be called once a tick, before anybody speaks. Returns how many
    /// aliases it looked at.
    pub(crate) fn release_idle_aliases(&mut self, tick: Tick) -> u64 {
        let mut looked = 0;
        if tick.value() >= self.swept.value() + ALIAS_IDLE_TICKS {
            self.swept = tick;
            looked = self.release_idle(tick);
        }
        self.free.extend(self.left.drain(..).map(Reverse));
        looked
    }

    fn release_idle(&mut self, tick: Tick) -> u64 {
        let mut looked = 0;
        let mut blocks = core::mem::take(&mut self.blocks);
        blocks.retain(|block| {
            let mut taken = false;
            for alias in block * BLOCK..self.end.min((block + 1) * BLOCK) {
                looked += 1;
                let (_, spoken) = self.aliases.aliases[alias as usize];
                let silent = (tick.value() as u32).wrapping_sub(spoken);
                let Some(body) = self.aliases.body(alias) else {
                    continue;
                };
                if u64::from(silent) >= ALIAS_IDLE_TICKS {
                    self.release(body);
                } else {
                    taken = true;
                }
            }
            taken
        });
        self.blocks = blocks;
        looked
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lowest_free_alias_is_assigned_and_idle_aliases_are_released() {
        let mut alias_table = AliasTable::default();
        for (body, alias) in [(70, 0), (3, 1), (900, 2)] {
            assert_eq!(alias_table.alias(body, Tick::new(1)), (alias, true));
        }
        alias_table.release(3);
        assert_eq!(alias_table.alias(8, Tick::new(1)), (3, true));
        alias_table.release_idle_aliases(Tick::new(2));
        assert_eq!(alias_table.alias(70, Tick::new(50)), (0, false));
        assert_eq!(alias_table.alias(4, Tick::new(50)), (1, true));
        alias_table.release_idle_aliases(Tick::new(70));
        assert_eq!(alias_table.aliases().of(900), None);
        assert_eq!(alias_table.alias(5, Tick::new(70)), (2, true));
        assert_eq!(alias_table.alias(6, Tick::new(70)), (3, true));
    }

    #[test]
    fn later_assignments_stay() {
        let mut aliases = ReceivedAliases::default();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        aliases.take(4, 7, Tick::new(8), AliasOwner::AsAssigned);
        assert_eq!(
            (aliases.now.body(4), aliases.now.of(9), aliases.now.of(7)),
            (Some(9), Some(4), None)
        );
        aliases.take(2, 9, Tick::new(11), AliasOwner::AsAssigned);
        assert_eq!((aliases.now.body(4), aliases.now.body(2)), (None, Some(9)));
        aliases.take(2, 7, Tick::new(12), AliasOwner::AsAssigned);
        assert_eq!((aliases.now.of(9), aliases.now.of(7)), (None, Some(2)));
        aliases.take(5, 7, Tick::new(11), AliasOwner::AsAssigned);
        assert_eq!((aliases.now.body(5), aliases.now.of(7)), (None, Some(2)));
    }

    #[test]
    fn repeated_assignments_take_no_memory() {
        let mut aliases = left_at_twelve();
        for _ in 0..=ALIAS_CHANGES_KEPT {
            aliases.take(4, 9, Tick::new(10), AliasOwner::MovedOn);
        }
        assert_eq!(aliases.body_then(4, Tick::new(11)), Some(9));
        for since in 0..=ALIAS_CHANGES_KEPT as u64 {
            aliases.take(5, 8, Tick::new(since), AliasOwner::MovedOn);
        }
        assert_eq!(aliases.body_then(4, Tick::new(11)), None);
    }

    /// ReceivedAliases that remember, in which body 9 sat in alias 4 from tick 10 on and came to rest at tick 12.
    fn left_at_twelve() -> ReceivedAliases {
        let mut aliases = ReceivedAliases::default();
        aliases.remember();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        aliases.release(9, Tick::new(12));
        aliases
    }

    #[test]
    fn released_alias_is_remembered_while_packets_are_missing() {
        let mut aliases = left_at_twelve();
        let owners = |aliases: &ReceivedAliases, alias| {
            [9, 10, 12, 13, 15].map(|tick| {
                let tick = Tick::new(tick);
                let now = aliases.body_since(alias, tick);
                now.or_else(|| aliases.body_then(alias, tick))
            })
        };
        assert_eq!(owners(&aliases, 4), [None, Some(9), Some(9), None, None]);
        aliases.take(4, 7, Tick::new(15), AliasOwner::AsAssigned);
        assert_eq!(owners(&aliases, 4), [None, Some(9), Some(9), None, Some(7)]);
        // Heard late: another one took it between the two.
        aliases.take(4, 6, Tick::new(13), AliasOwner::MovedOn);
        assert_eq!(
            owners(&aliases, 4),
            [None, Some(9), Some(9), Some(6), Some(7)]
        );
        // Heard later still: body 9 had gone elsewhere before.
        aliases.take(5, 9, Tick::new(11), AliasOwner::AsAssigned);
        assert_eq!(owners(&aliases, 4), [None, Some(9), None, Some(6), Some(7)]);
        aliases.refresh(Tick::new(13));
        assert_eq!(owners(&aliases, 4), [None, None, None, Some(6), Some(7)]);
        aliases.forget();
        assert_eq!(owners(&aliases, 4), [None, None, None, None, Some(7)]);
    }

    #[test]
    fn removed_body_hides_earlier_alias_owners() {
        let mut aliases = left_at_twelve();
        aliases.take(4, 7, Tick::new(8), AliasOwner::AsAssigned);
        aliases.clear(9);
        let then = [8, 9, 10, 11].map(|tick| aliases.body_then(4, Tick::new(tick)));
        assert_eq!(then, [Some(7), Some(7), None, None]);
    }

    #[test]
    fn alias_memory_overflow_forgets_all_owners() {
        let mut aliases = left_at_twelve();
        for body in 0..ALIAS_CHANGES_KEPT as u32 {
            aliases.take(5, 100 + body, Tick::new(20), AliasOwner::AsAssigned);
        }
        assert_eq!(aliases.body_then(4, Tick::new(11)), None);
        aliases.forget();
        assert_eq!(
            aliases.body_since(5, Tick::new(20)),
            Some(99 + ALIAS_CHANGES_KEPT as u32)
        );
    }

    #[test]
    fn newer_updates_block_older_assignments() {
        let mut aliases = ReceivedAliases::default();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        aliases.take(4, 7, Tick::new(12), AliasOwner::MovedOn);
        assert_eq!((aliases.now.body(4), aliases.now.of(9)), (None, None));
        aliases.take(4, 9, Tick::new(11), AliasOwner::AsAssigned);
        assert_eq!(aliases.now.of(9), None);
        aliases.take(4, 9, Tick::new(13), AliasOwner::AsAssigned);
        aliases.take(4, 9, Tick::new(14), AliasOwner::MovedOn);
        assert_eq!(aliases.body_since(4, Tick::new(13)), Some(9));
    }
}
