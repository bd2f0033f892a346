//! How far the tumblings of bodies were computed
//!
//! What is kept here changes what an answer costs, never its bits.

use alloc::vec::Vec;
use core::cell::Cell;
use core::fmt;

use rhumb_reckoning::Cursor;

use crate::room::grow_to;

/// By index, as far as any body tumbles.
#[derive(Default)]
pub(super) struct Cursors(Vec<Cell<Cursor>>);

impl Clone for Cursors {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl fmt::Debug for Cursors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Cursors").field(&self.0.len()).finish()
    }
}

impl Cursors {
    /// The body of this index tumbles when it is free.
    pub(super) fn reach(&mut self, index: u32) {
        grow_to(&mut self.0, index as usize + 1, Cell::default);
    }

    /// Works with the cursor of a body, or with one of its own where none is kept.
    pub(super) fn with<T>(&self, index: u32, work: impl FnOnce(&mut Cursor) -> T) -> T {
        let place = self.0.get(index as usize);
        let mut cursor = place.map(Cell::take).unwrap_or_default();
        let done = work(&mut cursor);
        if let Some(place) = place {
            place.set(cursor);
        }
        done
    }
}
