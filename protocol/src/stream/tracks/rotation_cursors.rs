//! How far the torque_free_rotations of bodies were computed
//!
//! What is kept here changes what an answer costs, never its bits.

use alloc::vec::Vec;
use core::cell::Cell;
use core::fmt;

use rhumb_reckoning::RotationCursor;

use crate::capacity::grow_to;

/// By index, as far as any body is_torque_free.
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
    /// The body of this index is_torque_free when it is free.
    pub(super) fn reach(&mut self, index: u32) {
        grow_to(&mut self.0, index as usize + 1, Cell::default);
    }

    /// Works with the cursor of a body, or with one of its own where none is kept.
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
