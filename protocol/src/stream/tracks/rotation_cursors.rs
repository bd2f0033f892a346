//! Cached states of torque-free rotation, by body.
//!
//! The cache changes the cost of a prediction, never its bits.

use alloc::vec::Vec;
use core::cell::Cell;
use core::fmt;

use rhumb_reckoning::RotationCursor;

use crate::interner::grow_to;

/// By index, up to the last body with torque-free rotation.
#[derive(Default)]
pub(super) struct RotationCursors(Vec<Cell<RotationCursor>>);

impl Clone for RotationCursors {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl fmt::Debug for RotationCursors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("RotationCursors")
            .field(&self.0.len())
            .finish()
    }
}

impl RotationCursors {
    /// Makes a cursor for a body with torque-free rotation.
    pub(super) fn reach(&mut self, index: u32) {
        grow_to(&mut self.0, index as usize + 1, Cell::default);
    }

    /// Calls `work` with the cursor of a body, or with a new one if none is cached.
    pub(super) fn with<T>(&self, index: u32, work: impl FnOnce(&mut RotationCursor) -> T) -> T {
        let place = self.0.get(index as usize);
        let mut cursor = place.map(Cell::take).unwrap_or_default();
        let done = work(&mut cursor);
        if let Some(place) = place {
            place.set(cursor);
        }
        done
    }
}
