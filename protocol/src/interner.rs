//! Tables of many bodies: interned values, and growth without spare room.
//!
//! Most bodies of a scene are alike: a table of bodies holds the number of a kind instead of the kind's data.
//! Invariant: a kind is kept exactly while it has users. Tables grow little by little, since doubling leaves half of
//! the capacity empty on average, for each body and stream.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

/// A value that can be shared.
pub(crate) trait Internable {
    /// Distinguishes kinds, bit for bit.
    type Key: Ord;

    /// The key of the value.
    fn key(&self) -> Self::Key;
}

/// The interned kinds, by number.
#[derive(Clone, Debug)]
pub(crate) struct Interner<K: Internable> {
    /// Kinds with their user counts; a kind without users is free.
    kinds: Vec<(K, u32)>,
    numbers: BTreeMap<K::Key, u32>,
    free: Vec<u32>,
}

impl<K: Internable> Default for Interner<K> {
    fn default() -> Self {
        Self {
            kinds: Vec::new(),
            numbers: BTreeMap::new(),
            free: Vec::new(),
        }
    }
}

impl<K: Internable> Interner<K> {
    pub(crate) fn get(&self, number: u32) -> &K {
        &self.kinds[number as usize].0
    }

    /// Adds a user of this kind; returns the kind's number.
    pub(crate) fn join(&mut self, kind: K) -> u32 {
        let key = kind.key();
        if let Some(number) = self.numbers.get(&key) {
            self.kinds[*number as usize].1 += 1;
            return *number;
        }
        let number = match self.free.pop() {
            Some(number) => {
                self.kinds[number as usize] = (kind, 1);
                number
            }
            None => {
                self.kinds.push((kind, 1));
                self.kinds.len() as u32 - 1
            }
        };
        self.numbers.insert(key, number);
        number
    }

    /// Removes a user of this kind.
    pub(crate) fn leave(&mut self, number: u32) {
        let (kind, members) = &mut self.kinds[number as usize];
        *members -= 1;
        if *members == 0 {
            self.numbers.remove(&kind.key());
            self.free.push(number);
        }
    }
}

/// Extends a table to a length. Its capacity grows by a thirty-second, so that little is unused.
#[inline]
pub(crate) fn grow_to<T>(table: &mut Vec<T>, len: usize, fill: impl FnMut() -> T) {
    if len > table.len() {
        extend(table, len, fill);
    }
}

#[cold]
fn extend<T>(table: &mut Vec<T>, len: usize, fill: impl FnMut() -> T) {
    if len > table.capacity() {
        let capacity = len.max(table.len() + table.len() / 32);
        table.reserve_exact(capacity - table.len());
    }
    table.resize_with(len, fill);
}

/// Appends to a list that is refilled again and again. Its capacity grows by an eighth once it exceeds [`SHORT`].
pub(crate) fn push<T>(list: &mut Vec<T>, more: T) {
    if list.len() == list.capacity() {
        list.reserve_exact((list.len() / 8).max(SHORT));
    }
    list.push(more);
}

/// Least capacity growth of a list.
const SHORT: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

    impl Internable for (u8, char) {
        type Key = u8;

        fn key(&self) -> u8 {
            self.0
        }
    }

    #[test]
    fn an_interned_value_is_stored_once_while_in_use() {
        let mut kinds = Interner::default();
        let numbers = [(5, 'a'), (6, 'b'), (5, 'c')].map(|kind| kinds.join(kind));
        assert_eq!(numbers, [0, 1, 0]);
        kinds.leave(0);
        assert_eq!(kinds.join((20, 'd')), 2);
        kinds.leave(0);
        assert_eq!(kinds.join((70, 'e')), 0);
        assert_eq!(kinds.join((5, 'f')), 3);
        assert_eq!(kinds.get(0), &(70, 'e'));
    }

    #[test]
    fn a_table_allocates_little_more_than_it_needs() {
        let (mut table, mut list) = (Vec::new(), Vec::new());
        for len in 1..5_000 {
            grow_to(&mut table, len, || 0_u8);
            push(&mut list, len);
            assert_eq!((table.len(), list.len()), (len, len));
            assert!(table.capacity() <= len + len / 32 + 1);
            assert!(list.capacity() <= len + (len / 8).max(SHORT));
        }
    }
}
