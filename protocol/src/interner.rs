//! What many things have in common, each kind kept once.
//!
//! Most bodies of a scene are alike, so that a table of bodies holds the number of a kind in place of all that makes it
//! one. Invariant: a kind is kept while something is of it, and no longer.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

/// What can be common to many.
pub(crate) trait Internable {
    /// What two kinds differ by, bit for bit.
    type Key: Ord;

    /// What tells it from others.
    fn key(&self) -> Self::Key;
}

/// Interner, by number.
#[derive(Clone, Debug)]
pub(crate) struct Interner<K: Internable> {
    /// With how many are of each; those of none are free.
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

    /// One more is of this kind; returns its number.
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

    /// One less is of this kind.
    pub(crate) fn leave(&mut self, number: u32) {
        let (kind, members) = &mut self.kinds[number as usize];
        *members -= 1;
        if *members == 0 {
            self.numbers.remove(&kind.key());
            self.free.push(number);
        }
    }
}

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
}
