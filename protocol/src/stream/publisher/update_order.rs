//! The order of a tick's updates in its packets, and their approximate sizes.
//!
//! Pure functions. Invariant: an update that builds on another body's track comes after that body.

use alloc::vec;
use alloc::vec::Vec;

use crate::packet::{CostModel, InitialCostModel, Update};

/// Aliases for each update, beyond which updates are sorted by comparisons instead of by a table of aliases.
const SPARSE_ALIASES: usize = 16;

/// The approximate cost of an update, in 1/256 bits.
pub(super) fn bits_of(update: &Update) -> u64 {
    /// The cost of a body's index and its new alias.
    const NAMED: u64 = 24 * 256;
    /// The cost of an existing alias.
    const ALIASED: u64 = 4 * 256;
    let name = if update.body.is_some() {
        NAMED
    } else {
        ALIASED
    };
    u64::from(InitialCostModel.cost(&update.payload)) + name
}

/// The number of first updates that take half of all bits.
pub(super) fn middle(updates: &[Update]) -> usize {
    let bits = updates.iter().map(bits_of);
    let half = bits.clone().sum::<u64>() / 2;
    let mut so_far = 0;
    let before = |bits: &u64| {
        so_far += bits;
        so_far <= half
    };
    bits.take_while(before).count().max(1)
}

/// Sorts updates by the aliases of their bodies, which differ from update to update.
pub(super) fn sort_by_alias(updates: &mut [Update]) {
    if updates.is_sorted_by_key(|update| update.alias) {
        return;
    }
    let end = updates
        .iter()
        .map(|update| update.alias as usize + 1)
        .max()
        .unwrap_or_default();
    if end > updates.len() * SPARSE_ALIASES {
        return sort_by_keys(updates, |update| u64::from(update.alias));
    }
    // By alias: the rank of its update.
    let mut ranks = vec![0_u32; end];
    for update in updates.iter() {
        ranks[update.alias as usize] = 1;
    }
    let mut next = 0;
    for rank in &mut ranks {
        next += core::mem::replace(rank, next);
    }
    // Each exchange brings an update to its place.
    for place in 0..updates.len() {
        loop {
            let rank = ranks[updates[place].alias as usize] as usize;
            if rank == place {
                break;
            }
            updates.swap(place, rank);
        }
    }
}

/// Sorts updates by alias, those that build on another body's track last. Returns the number of the others.
pub(super) fn sort_parents_first(updates: &mut [Update]) -> usize {
    let mut free = updates.iter().all(|update| !update.payload.names_parent());
    free &= updates.is_sorted_by_key(|update| update.alias);
    if free {
        return updates.len();
    }
    sort_by_keys(updates, |update| {
        u64::from(update.payload.names_parent()) << 32 | u64::from(update.alias)
    });
    updates.partition_point(|update| !update.payload.names_parent())
}

/// Sorts updates by keys that differ. Updates are large, so each is moved only once.
fn sort_by_keys(updates: &mut [Update], key: impl Fn(&Update) -> u64) {
    let mut order: Vec<(u64, usize)> = updates.iter().map(key).zip(0..).collect();
    order.sort_unstable();
    let mut ranks = vec![0; updates.len()];
    for (rank, (_, place)) in order.into_iter().enumerate() {
        ranks[place] = rank;
    }
    for place in 0..updates.len() {
        while ranks[place] != place {
            let rank = ranks[place];
            updates.swap(place, rank);
            ranks.swap(place, rank);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::{Keyframe, UpdatePayload};
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor};

    fn update(alias: u32, parent: Option<u32>) -> Update {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Update {
            alias,
            body: Some(alias),
            payload: UpdatePayload::Keyframe(Keyframe {
                predictor: Predictor::Uniform,
                anchor: Anchor::Exact(still.expect("it is finite")),
                parent: parent.map(|index| BodyId::new(index, 0)),
            }),
        }
    }

    /// Updates with different aliases below `end`, in any order.
    fn updates(end: u32) -> impl Strategy<Value = Vec<Update>> {
        let parents =
            proptest::collection::btree_map(0..end, proptest::option::of(0_u32..9), 0..40);
        let updates = parents.prop_map(|parents| {
            let updates = parents
                .into_iter()
                .map(|(alias, parent)| update(alias, parent));
            updates.collect::<Vec<_>>()
        });
        updates.prop_shuffle()
    }

    proptest! {
        #[test]
        fn updates_are_sorted_by_alias_however_far_apart_aliases_are(
            (mut few, mut many) in (updates(60), updates(100_000)),
        ) {
            for updates in [&mut few, &mut many] {
                let mut expected = updates.clone();
                expected.sort_by_key(|update| update.alias);
                sort_by_alias(updates);
                prop_assert_eq!(&*updates, &expected);
            }
        }

        #[test]
        fn updates_that_name_a_parent_come_last(mut updates in updates(60)) {
            let alone = sort_parents_first(&mut updates);
            let (first, last) = updates.split_at(alone);
            prop_assert!(first.iter().all(|update| !update.payload.names_parent()));
            prop_assert!(last.iter().all(|update| update.payload.names_parent()));
            for group in [first, last] {
                prop_assert!(group.is_sorted_by_key(|update| update.alias));
            }
        }

        #[test]
        fn the_first_half_of_several_updates_takes_at_most_half_of_the_bits(updates in updates(60)) {
            prop_assume!(updates.len() > 1);
            let bits = |updates: &[Update]| updates.iter().map(bits_of).sum::<u64>();
            let middle = middle(&updates);
            prop_assert!(middle < updates.len());
            prop_assert!(middle == 1 || bits(&updates[..middle]) <= bits(&updates) / 2);
            prop_assert!(bits(&updates[..=middle]) > bits(&updates) / 2);
        }
    }
}
