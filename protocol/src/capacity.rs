//! Growth of tables with little spare capacity.
//!
//! Doubling leaves half of the capacity empty on average, for each body and stream.

use alloc::vec::Vec;

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
