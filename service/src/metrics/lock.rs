//! Access to figures that are more than a number.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Locks; a thread that panicked while it counted leaves the figures as they are.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
