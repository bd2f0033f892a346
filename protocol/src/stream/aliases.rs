//! Aliases: small numbers for the bodies that are updated often.
//!
//! Publisher and subscriber keep the assignments. The publisher decides, and sends each assignment. A subscriber that
//! missed one finds no body under the alias, or a body whose track has another age: it never confuses two bodies
//! (PROTOCOL 6.13).

use alloc::collections::BinaryHeap;
use alloc::vec::Vec;
use core::cmp::Reverse;
use core::num::NonZeroU32;

use rhumb_reckoning::Tick;

use crate::interner::grow_to;

/// The assignments of aliases to bodies, and a value of type `T` for each alias.
#[derive(Clone, Debug, Default)]
pub(crate) struct AliasMap<T> {
    /// By alias: one more than the index of its body, None for a free alias, and the value.
    aliases: Vec<(Option<NonZeroU32>, T)>,
    /// By index of the body: one more than its alias; 0 for none.
    of_body: Vec<u32>,
}

impl<T: Clone + Default> AliasMap<T> {
    /// The body that has an alias.
    pub(crate) fn body(&self, alias: u32) -> Option<u32> {
        let (body, _) = self.aliases.get(alias as usize)?;
        Some((*body)?.get() - 1)
    }

    /// The alias of a body.
    pub(crate) fn of(&self, body: u32) -> Option<u32> {
        self.of_body.get(body as usize)?.checked_sub(1)
    }

    /// Assigns an alias to a body; the body that had it loses it.
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

    /// Frees an alias; the body that had it loses it.
    fn empty(&mut self, alias: u32, more: T) {
        let place = alias as usize;
        grow_to(&mut self.aliases, place + 1, || (None, T::default()));
        if let Some(before) = self.body(alias) {
            self.of_body[before as usize] = 0;
        }
        self.aliases[place] = (None, more);
    }

    /// Frees the alias of a body, if it has one, and returns it.
    fn release(&mut self, body: u32) -> Option<u32> {
        let alias = self.of(body)?;
        self.of_body[body as usize] = 0;
        self.aliases[alias as usize].0 = None;
        Some(alias)
    }
}

/// A tick as two 32-bit words: as a u64 its alignment would enlarge the entries of the table.
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

/// State of the body of an assignment when the assignment arrives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AliasOwner {
    /// The body has no newer track.
    AsAssigned,
    /// The body has a newer track, or was removed.
    Newer,
}

/// The aliases of a subscriber: for each, the body that took it last, and the tick.
///
/// A body keeps its alias when it comes to rest: until another body takes the alias, late updates with this alias are
/// updates of that body.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReceivedAliases {
    now: AliasMap<PackedTick>,
}

impl ReceivedAliases {
    /// The body that has an alias since a tick or earlier, if there is one.
    pub(crate) fn body_since(&self, alias: u32, tick: Tick) -> Option<u32> {
        self.now.body(alias).filter(|_| self.since(alias) <= tick)
    }

    /// The alias of a body.
    pub(crate) fn of(&self, body: u32) -> Option<u32> {
        self.now.of(body)
    }

    /// Assigns an alias to a body at a tick (PROTOCOL 6.13-7). Later assignments stay.
    ///
    /// A body with a newer track may have lost the alias since: then the alias names no body, unless it already names
    /// this one.
    pub(crate) fn take(&mut self, alias: u32, body: u32, tick: Tick, owner: AliasOwner) {
        let later = |alias: u32| self.since(alias) > tick;
        let (is_newer, had) = (owner == AliasOwner::Newer, self.now.of(body));
        let (taken, moved) = (later(alias), had.is_some_and(later));
        if taken || (is_newer && had == Some(alias)) {
            return;
        }
        if is_newer || moved {
            self.now.empty(alias, PackedTick::of(tick));
        } else {
            self.now.put(alias, body, PackedTick::of(tick));
        }
    }

    /// Releases the alias of an index when a body is placed there or removed.
    pub(crate) fn clear(&mut self, body: u32) {
        self.now.release(body);
    }

    /// Releases the alias that a body has since a tick or earlier.
    pub(crate) fn release_by(&mut self, body: u32, tick: Tick) {
        if self
            .now
            .of(body)
            .is_some_and(|alias| self.since(alias) <= tick)
        {
            self.now.release(body);
        }
    }

    /// The tick of an alias's newest assignment.
    fn since(&self, alias: u32) -> Tick {
        let alias = self.now.aliases.get(alias as usize);
        alias.map_or(Tick::ZERO, |(_, since)| since.tick())
    }
}

/// Assigns aliases: the lowest free one first.
#[derive(Clone, Debug, Default)]
pub(crate) struct AliasTable {
    aliases: AliasMap<()>,
    free: BinaryHeap<Reverse<u32>>,
    /// Freed since the last call of `begin_tick`. They are assigned again only after the next call, so no alias has two
    /// bodies in one tick.
    freed: Vec<u32>,
    /// No alias from this one on was ever assigned.
    end: u32,
}

impl AliasTable {
    /// The present assignments.
    pub(crate) const fn aliases(&self) -> &AliasMap<()> {
        &self.aliases
    }

    /// The alias of an updated body, and whether this update assigns it.
    pub(crate) fn alias(&mut self, body: u32) -> (u32, bool) {
        if let Some(alias) = self.aliases.of(body) {
            return (alias, false);
        }
        let alias = self.free.pop().map_or_else(
            || {
                self.end += 1;
                self.end - 1
            },
            |Reverse(alias)| alias,
        );
        self.aliases.put(alias, body, ());
        (alias, true)
    }

    /// The alias of an updated body where it is the body's index, and whether this update assigns it.
    pub(crate) fn alias_of_index(&mut self, body: u32) -> (u32, bool) {
        let taken = self.aliases.of(body).is_none();
        if taken {
            self.aliases.put(body, body, ());
        }
        (body, taken)
    }

    /// Frees the alias of a body that comes to rest or leaves the scene. It can be assigned from the next tick on.
    pub(crate) fn release(&mut self, body: u32) {
        if let Some(alias) = self.aliases.release(body) {
            self.freed.push(alias);
        }
    }

    /// Makes freed aliases available. Call it once a tick, before any update.
    pub(crate) fn begin_tick(&mut self) {
        self.free.extend(self.freed.drain(..).map(Reverse));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_free_alias_is_assigned_and_a_freed_one_from_the_next_tick_on() {
        let mut alias_table = AliasTable::default();
        for (body, alias) in [(70, 0), (3, 1), (900, 2)] {
            assert_eq!(alias_table.alias(body), (alias, true));
        }
        alias_table.release(900);
        alias_table.release(3);
        assert_eq!(alias_table.alias(8), (3, true));
        alias_table.begin_tick();
        assert_eq!(alias_table.alias(70), (0, false));
        assert_eq!(alias_table.alias(4), (1, true));
        assert_eq!(alias_table.alias(5), (2, true));
        assert_eq!(alias_table.aliases().of(900), None);
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
    fn a_body_at_rest_keeps_its_alias_until_another_takes_it() {
        let mut aliases = ReceivedAliases::default();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        assert_eq!(aliases.body_since(4, Tick::new(9)), None);
        assert_eq!(aliases.body_since(4, Tick::new(14)), Some(9));
        aliases.take(4, 7, Tick::new(15), AliasOwner::AsAssigned);
        assert_eq!(aliases.body_since(4, Tick::new(14)), None);
        assert_eq!(aliases.body_since(4, Tick::new(15)), Some(7));
        aliases.release_by(7, Tick::new(14));
        assert_eq!(aliases.body_since(4, Tick::new(16)), Some(7));
        aliases.release_by(7, Tick::new(15));
        assert_eq!(aliases.body_since(4, Tick::new(16)), None);
    }

    #[test]
    fn a_body_that_takes_its_alias_again_has_it_since_then() {
        let mut aliases = ReceivedAliases::default();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        aliases.take(4, 9, Tick::new(20), AliasOwner::AsAssigned);
        assert_eq!(aliases.body_since(4, Tick::new(15)), None);
        assert_eq!(aliases.body_since(4, Tick::new(20)), Some(9));
        aliases.clear(9);
        assert_eq!(aliases.body_since(4, Tick::new(20)), None);
    }

    #[test]
    fn newer_updates_block_older_assignments() {
        let mut aliases = ReceivedAliases::default();
        aliases.take(4, 9, Tick::new(10), AliasOwner::AsAssigned);
        aliases.take(4, 7, Tick::new(12), AliasOwner::Newer);
        assert_eq!((aliases.now.body(4), aliases.now.of(9)), (None, None));
        aliases.take(4, 9, Tick::new(11), AliasOwner::AsAssigned);
        assert_eq!(aliases.now.of(9), None);
        aliases.take(4, 9, Tick::new(13), AliasOwner::AsAssigned);
        aliases.take(4, 9, Tick::new(14), AliasOwner::Newer);
        assert_eq!(aliases.body_since(4, Tick::new(13)), Some(9));
    }
}
