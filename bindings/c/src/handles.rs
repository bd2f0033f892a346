//! Handles: numbers that name what C holds, and are never given out twice.
//!
//! A number can be wrong without harm, which a pointer cannot. One thread at a time may be inside a call of a handle; a
//! second one gets an error and does not wait.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use rhumb_bindings::BindingError;

/// The next handle's number, of any kind: a handle of one kind is none of another.
static NEXT: AtomicU64 = AtomicU64::new(1);

/// The things that the handles of one kind name.
pub(crate) struct HandleTable<T> {
    entries: Mutex<BTreeMap<u64, Arc<Mutex<T>>>>,
}

impl<T> HandleTable<T> {
    pub(crate) const fn new() -> Self {
        Self {
            entries: Mutex::new(BTreeMap::new()),
        }
    }

    /// Gives out a handle.
    pub(crate) fn insert(&self, value: T) -> u64 {
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        self.entries().insert(number, Arc::new(Mutex::new(value)));
        number
    }

    /// Ends a handle. A call of another thread that is inside it continues, and its end drops the value.
    pub(crate) fn remove(&self, number: u64) -> Result<Arc<Mutex<T>>, BindingError> {
        self.entries().remove(&number).ok_or(BindingError::Closed)
    }

    /// Ends a handle, and returns its value. The handle stays if the value fails the check, or a call is inside it.
    pub(crate) fn take(
        &self,
        number: u64,
        check: impl FnOnce(&T) -> Result<(), BindingError>,
    ) -> Result<T, BindingError> {
        let mut entries = self.entries();
        let entry = entries.get_mut(&number).ok_or(BindingError::Closed)?;
        // Calls share an entry only while the table is locked, so that it remains this one's.
        let value = Arc::get_mut(entry).ok_or(BindingError::Busy)?;
        check(value.get_mut().map_err(|_| BindingError::Closed)?)?;
        let entry = entries.remove(&number).ok_or(BindingError::Closed)?;
        let value = Arc::into_inner(entry).ok_or(BindingError::Busy)?;
        value.into_inner().map_err(|_| BindingError::Closed)
    }

    /// Calls with what a handle names.
    pub(crate) fn with<R>(
        &self,
        number: u64,
        call: impl FnOnce(&mut T) -> Result<R, BindingError>,
    ) -> Result<R, BindingError> {
        let entry = self.entries().get(&number).cloned();
        let entry = entry.ok_or(BindingError::Closed)?;
        let mut value = entry.try_lock().map_err(|error| match error {
            TryLockError::WouldBlock => BindingError::Busy,
            TryLockError::Poisoned(_) => {
                BindingError::Fault("an earlier call with this handle panicked; close it".into())
            }
        })?;
        call(&mut value)
    }

    fn entries(&self) -> MutexGuard<'_, BTreeMap<u64, Arc<Mutex<T>>>> {
        // A panic while it was locked would have left it whole: it is only looked up and changed by single calls.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_bindings::ErrorKind;

    fn kind<T>(result: Result<T, BindingError>) -> Option<ErrorKind> {
        result.err().map(|error| error.kind())
    }

    #[test]
    fn a_handle_names_one_value_until_it_is_removed_and_nothing_afterwards() {
        let (numbers, texts) = (HandleTable::new(), HandleTable::new());
        let (number, text) = (numbers.insert(7), texts.insert("seven"));
        assert_ne!(number, text);
        assert_eq!(numbers.with(number, |value| Ok(*value)).unwrap(), 7);
        assert_eq!(
            kind(numbers.with(text, |_| Ok(()))),
            Some(ErrorKind::Closed)
        );
        numbers.remove(number).expect("it is there");
        assert_eq!(
            kind(numbers.with(number, |_| Ok(()))),
            Some(ErrorKind::Closed)
        );
        assert_eq!(kind(numbers.remove(number)), Some(ErrorKind::Closed));
        assert_eq!(kind(numbers.with(0, |_| Ok(()))), Some(ErrorKind::Closed));
        assert_ne!(numbers.insert(8), number);
    }

    #[test]
    fn a_second_thread_gets_an_error_and_does_not_wait() {
        let table = HandleTable::new();
        let number = table.insert(());
        let inside = table.with(number, |()| {
            let other = std::thread::scope(|scope| {
                let call = scope.spawn(|| kind(table.with(number, |()| Ok(()))));
                call.join().expect("the thread ends")
            });
            assert_eq!(other, Some(ErrorKind::Busy));
            // Its removal does not disturb the call either.
            table.remove(number).map(drop)
        });
        assert!(inside.is_ok());
        assert_eq!(
            kind(table.with(number, |()| Ok(()))),
            Some(ErrorKind::Closed)
        );
    }

    #[test]
    fn a_value_is_taken_unless_it_fails_the_check_or_is_in_use() {
        let table = HandleTable::new();
        let number = table.insert(7);
        let wrong = table.take(number, |_| Err(BindingError::Null("value")));
        assert_eq!(kind(wrong), Some(ErrorKind::Null));
        let inside = table.with(number, |_| {
            assert_eq!(kind(table.take(number, |_| Ok(()))), Some(ErrorKind::Busy));
            Ok(())
        });
        assert!(inside.is_ok());
        assert_eq!(table.take(number, |_| Ok(())).unwrap(), 7);
        assert_eq!(
            kind(table.take(number, |_| Ok(()))),
            Some(ErrorKind::Closed)
        );
    }

    #[test]
    fn a_handle_whose_call_panicked_can_only_be_removed() {
        let table = HandleTable::new();
        let number = table.insert(());
        let call =
            std::panic::AssertUnwindSafe(|| table.with::<()>(number, |()| panic!("half done")));
        assert!(std::panic::catch_unwind(call).is_err());
        assert_eq!(
            kind(table.with(number, |()| Ok(()))),
            Some(ErrorKind::Fault)
        );
        assert!(table.remove(number).is_ok());
    }
}
