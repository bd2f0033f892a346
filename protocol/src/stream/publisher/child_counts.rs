//! The bodies that others are attached to, with their numbers of children.
//!
//! Few bodies are parents, so they are kept in a short list. Invariant: the list rises by index, and no count is zero.

use alloc::vec::Vec;

use rhumb_reckoning::BodyId;

/// Parents and their numbers of children, in order of index.
#[derive(Clone, Debug, Default)]
pub(super) struct ChildCounts {
    counts: Vec<(u32, u32)>,
}

impl ChildCounts {
    /// Moves a child from one parent to another.
    pub(super) fn move_child(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        if let Some(from) = from
            && let Ok(at) = self.place(from.index())
        {
            self.counts[at].1 -= 1;
            if self.counts[at].1 == 0 {
                self.counts.remove(at);
            }
        }
        if let Some(to) = to {
            match self.place(to.index()) {
                Ok(at) => self.counts[at].1 += 1,
                Err(at) => self.counts.insert(at, (to.index(), 1)),
            }
        }
    }

    /// True if a body has children.
    pub(super) fn has_children(&self, index: u32) -> bool {
        self.place(index).is_ok()
    }

    /// The position of a parent in the list, or where it would be inserted.
    fn place(&self, index: u32) -> Result<usize, usize> {
        self.counts
            .binary_search_by_key(&index, |(parent, _)| *parent)
    }

    /// The number of children of a body.
    #[cfg(test)]
    pub(super) fn of(&self, index: u32) -> u32 {
        self.place(index).map_or(0, |at| self.counts[at].1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::collections::BTreeMap;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn each_parent_has_as_many_children_as_moved_to_it(
            moves in proptest::collection::vec((0_usize..30, proptest::option::of(0_u32..8)), 0..200),
        ) {
            let mut child_counts = ChildCounts::default();
            let mut parents = BTreeMap::new();
            for (child, to) in moves {
                let to = to.map(|index| BodyId::new(index, 0));
                let from = parents.insert(child, to).flatten();
                child_counts.move_child(from, to);
                for index in 0..10 {
                    let is_child = |parent: &&Option<BodyId>| parent.map(BodyId::index) == Some(index);
                    let expected = parents.values().filter(is_child).count() as u32;
                    prop_assert_eq!(child_counts.of(index), expected);
                    prop_assert_eq!(child_counts.has_children(index), expected > 0);
                }
                prop_assert!(child_counts.counts.is_sorted());
            }
        }
    }
}
