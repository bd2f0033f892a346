//! Tables that have little more room than they need.
//!
//! Doubled room would be half empty on average, for each body and stream.

use alloc::vec::Vec;

/// Makes a table at least so long. Its room grows by a thirty-second, so that it is little more than what is in it.
pub(crate) fn grow_to<T>(table: &mut Vec<T>, len: usize, fill: impl FnMut() -> T) {
    if len > table.capacity() {
        let room = len.max(table.len() + table.len() / 32);
        table.reserve_exact(room - table.len());
    }
    if len > table.len() {
        table.resize_with(len, fill);
    }
}

/// Adds to a list that is filled anew again and again. Its room grows by an eighth, while it is short by [`SHORT`].
pub(crate) fn push<T>(list: &mut Vec<T>, more: T) {
    if list.len() == list.capacity() {
        list.reserve_exact((list.len() / 8).max(SHORT));
    }
    list.push(more);
}

/// Places for which no list asks one by one.
const SHORT: usize = 64;

#[cfg(test)]
mod tests {
    use super::*;

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
