//! The border between C and Rust: result codes, pointers, handles.
//!
//! Every function that C calls goes through [`guard`], where panics stop. All other files take pointers only by the
//! functions of this one.
//!
//! A handle is a number that is never given out twice: it can be wrong without harm, which a pointer cannot. One thread at
//! a time may be inside a call of a handle; a second one gets an error and does not wait.

use std::any::Any;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

use rhumb_bindings::{BindingError, ErrorKind};

/// The result of a call.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCode {
    /// The call did what it says.
    Ok,
    /// An argument is wrong; nothing was done.
    Invalid,
    /// A pointer is null; nothing was done.
    Null,
    /// A buffer is too small; nothing was written to it.
    TooSmall,
    /// The handle is closed, or was never open.
    Closed,
    /// Another thread is inside a call with the same handle; nothing was done.
    Busy,
    /// The server was not reached, or is not the one that is trusted.
    Connect,
    /// The server denied the request.
    Denied,
    /// The server did not answer in time. The call may be repeated; nothing is lost.
    Timeout,
    /// The connection is over.
    Ended,
    /// The scene was deleted, or its physics engine failed.
    SceneGone,
    /// A fault of this library. The scene can only be closed.
    Fault,
    /// The server refused requests of earlier calls, which `rhumb_scene_poll_refusal` names. The call did what it says all
    /// the same, and the next one continues.
    Refused,
}

impl RhumbCode {
    pub(crate) const fn of(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::Invalid => Self::Invalid,
            ErrorKind::Null => Self::Null,
            ErrorKind::TooSmall => Self::TooSmall,
            ErrorKind::Closed => Self::Closed,
            ErrorKind::Busy => Self::Busy,
            ErrorKind::Connect => Self::Connect,
            ErrorKind::Denied => Self::Denied,
            ErrorKind::Timeout => Self::Timeout,
            ErrorKind::Ended => Self::Ended,
            ErrorKind::SceneGone => Self::SceneGone,
            ErrorKind::Fault => Self::Fault,
            ErrorKind::Refused => Self::Refused,
        }
    }
}

thread_local! {
    /// The sentence of this thread's last error.
    static LAST_ERROR: RefCell<CString> = RefCell::default();
}

/// Keeps the sentence of an error for `rhumb_last_error`, unless the thread is at its end.
fn keep_error(error: &BindingError) {
    // A zero byte would end the sentence early.
    let bytes = error.to_string().into_bytes();
    let bytes: Vec<u8> = bytes.into_iter().filter(|byte| *byte != 0).collect();
    let Ok(text) = CString::new(bytes) else {
        return;
    };
    // A static object of a program may close a handle after its thread has given up the sentence. A panic here would end
    // the process: no caller of this function catches it.
    let _kept = LAST_ERROR.try_with(|last| {
        if let Ok(mut last) = last.try_borrow_mut() {
            *last = text;
        }
    });
}

/// The sentence of the last error of the calling thread: what was wrong, where, and what to do. Empty before the first.
///
/// Never null. The text is valid until the next call of this library on the same thread. Do not free it.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_last_error() -> *const c_char {
    LAST_ERROR
        .try_with(|last| last.try_borrow().map(|text| text.as_ptr()).ok())
        .ok()
        .flatten()
        .unwrap_or(c"".as_ptr())
}

/// The version of the library that runs: major × 65,536 + minor × 256 + patch.
///
/// Until version 1, the interface may change with each minor version; after it, with each major version.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_version() -> u32 {
    let number = |text: &str| text.parse().unwrap_or(0);
    let (major, minor, patch) = (
        number(env!("CARGO_PKG_VERSION_MAJOR")),
        number(env!("CARGO_PKG_VERSION_MINOR")),
        number(env!("CARGO_PKG_VERSION_PATCH")),
    );
    (major << 16) | (minor << 8) | patch
}

/// Runs a call; an error or a panic becomes a code, and its sentence is kept.
pub(crate) fn guard(call: impl FnOnce() -> Result<(), BindingError>) -> RhumbCode {
    // A panic inside a scene's call poisons its lock, so that no later call sees half of a change.
    let result = catch_unwind(AssertUnwindSafe(call))
        .unwrap_or_else(|panic| Err(BindingError::Fault(panic_text(panic.as_ref()))));
    match result {
        Ok(()) => RhumbCode::Ok,
        Err(error) => {
            keep_error(&error);
            RhumbCode::of(error.kind())
        }
    }
}

fn panic_text(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("a panic without a text").to_owned()
}

/// The value behind a pointer.
///
/// # Safety
///
/// A pointer that is neither null nor misaligned points to a valid `T` that nothing changes during the call.
pub(crate) unsafe fn value<'a, T>(
    pointer: *const T,
    argument: &'static str,
) -> Result<&'a T, BindingError> {
    check_aligned(pointer, argument)?;
    // SAFETY: the caller of this function promises what is behind a pointer that is not null.
    unsafe { pointer.as_ref() }.ok_or(BindingError::Null(argument))
}

/// The elements behind a pointer. No elements need no pointer.
///
/// # Safety
///
/// A pointer that is neither null nor misaligned points to `count` valid elements that nothing changes during the call.
pub(crate) unsafe fn elements<'a, T>(
    pointer: *const T,
    count: usize,
    argument: &'static str,
) -> Result<&'a [T], BindingError> {
    if count == 0 {
        return Ok(&[]);
    }
    check_size::<T>(count, argument)?;
    check_aligned(pointer, argument)?;
    if pointer.is_null() {
        return Err(BindingError::Null(argument));
    }
    // SAFETY: not null, aligned, not longer than memory can be; the caller of this function promises the elements.
    Ok(unsafe { std::slice::from_raw_parts(pointer, count) })
}

/// Writes a value where a pointer says.
///
/// # Safety
///
/// A pointer that is neither null nor misaligned points to memory for a `T` that nothing else uses during the call.
pub(crate) unsafe fn write<T>(
    pointer: *mut T,
    value: T,
    argument: &'static str,
) -> Result<(), BindingError> {
    check_out(pointer, argument)?;
    // SAFETY: not null, aligned; the caller of this function promises the memory.
    unsafe { pointer.write(value) };
    Ok(())
}

/// Writes a value where a pointer says, unless it is null.
///
/// # Safety
///
/// As [`write`].
pub(crate) unsafe fn write_if_wanted<T>(
    pointer: *mut T,
    value: T,
    argument: &'static str,
) -> Result<(), BindingError> {
    if pointer.is_null() {
        return Ok(());
    }
    // SAFETY: the caller of this function promises what `write` needs.
    unsafe { write(pointer, value, argument) }
}

/// Copies values into a buffer.
///
/// # Safety
///
/// A pointer that is neither null nor misaligned points to memory for `capacity` elements that nothing else uses during
/// the call.
pub(crate) unsafe fn copy_out<T: Copy>(
    pointer: *mut T,
    capacity: usize,
    values: &[T],
    argument: &'static str,
) -> Result<(), BindingError> {
    let needed = values.len();
    if needed > capacity {
        return Err(BindingError::TooSmall { capacity, needed });
    }
    if needed == 0 {
        return Ok(());
    }
    check_out(pointer, argument)?;
    // SAFETY: not null, aligned; the caller of this function promises memory for `capacity` elements, which is no less.
    // The values are this library's own, so the two do not overlap.
    unsafe { pointer.copy_from_nonoverlapping(values.as_ptr(), needed) };
    Ok(())
}

/// A text that ends with a zero byte; a longer one is cut between two characters.
pub(crate) fn copy_text<const BYTES: usize>(text: &str) -> [c_char; BYTES] {
    let mut copy = [0; BYTES];
    let end = text.floor_char_boundary(BYTES - 1);
    for (to, byte) in copy.iter_mut().zip(text[..end].bytes()) {
        *to = byte.cast_signed() as c_char;
    }
    copy
}

/// Checks a pointer to a result before the work is done.
pub(crate) fn check_out<T>(pointer: *mut T, argument: &'static str) -> Result<(), BindingError> {
    if pointer.is_null() {
        return Err(BindingError::Null(argument));
    }
    check_aligned(pointer, argument)
}

/// The text behind a pointer.
///
/// # Safety
///
/// A pointer that is not null points to a text that ends with a zero byte and that nothing changes during the call.
pub(crate) unsafe fn text<'a>(
    pointer: *const c_char,
    argument: &'static str,
) -> Result<&'a str, BindingError> {
    if pointer.is_null() {
        return Err(BindingError::Null(argument));
    }
    // SAFETY: not null; the caller of this function promises the rest.
    let text = unsafe { CStr::from_ptr(pointer) };
    let needed = "text in UTF-8";
    text.to_str()
        .map_err(|_| BindingError::Argument { argument, needed })
}

/// The same, where null stands for no text.
///
/// # Safety
///
/// As [`text`].
pub(crate) unsafe fn optional_text<'a>(
    pointer: *const c_char,
    argument: &'static str,
) -> Result<Option<&'a str>, BindingError> {
    match pointer.is_null() {
        true => Ok(None),
        // SAFETY: the caller of this function promises what `text` needs.
        false => unsafe { text(pointer, argument) }.map(Some),
    }
}

/// The value of a number that names one of several.
pub(crate) fn one_of<T: Copy>(
    each: &[T],
    number: u32,
    argument: &'static str,
) -> Result<T, BindingError> {
    let place = usize::try_from(number).unwrap_or(usize::MAX);
    let value = each.get(place).copied();
    value.ok_or_else(|| {
        let last = each.len().saturating_sub(1);
        BindingError::value(
            argument,
            number,
            format_args!("0 to {last}, as the header names them"),
        )
    })
}

fn check_aligned<T>(pointer: *const T, argument: &'static str) -> Result<(), BindingError> {
    let needed = "a pointer to its type, and is not aligned for it";
    match pointer.is_aligned() {
        true => Ok(()),
        false => Err(BindingError::Argument { argument, needed }),
    }
}

fn check_size<T>(count: usize, argument: &'static str) -> Result<(), BindingError> {
    let bytes = count.checked_mul(size_of::<T>().max(1));
    let fits = bytes.is_some_and(|bytes| isize::try_from(bytes).is_ok());
    let needed = "shorter: its count is larger than memory can be";
    match fits {
        true => Ok(()),
        false => Err(BindingError::Argument { argument, needed }),
    }
}

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
    use rhumb_bindings::ErrorKind;

    use super::*;

    fn last_error() -> String {
        // SAFETY: the text is valid until this thread's next call, and is copied.
        let text = unsafe { CStr::from_ptr(rhumb_last_error()) };
        text.to_string_lossy().into_owned()
    }

    #[test]
    fn a_panic_is_a_code_and_a_sentence() {
        let code = guard(|| panic!("the {} failed", "test"));
        assert_eq!(code, RhumbCode::Fault);
        assert_eq!(last_error(), "a fault of this library: the test failed");
        let code = guard(|| std::panic::panic_any(7_u8));
        assert_eq!(code, RhumbCode::Fault);
        assert!(last_error().ends_with("a panic without a text"));
    }

    #[test]
    fn the_last_error_belongs_to_its_thread_and_outlives_a_success() {
        assert_eq!(last_error(), "");
        assert_eq!(guard(|| Err(BindingError::Null("descs"))), RhumbCode::Null);
        assert_eq!(guard(|| Ok(())), RhumbCode::Ok);
        assert_eq!(last_error(), "descs must not be null");
        let other = std::thread::spawn(last_error).join();
        assert_eq!(other.expect("the thread ends"), "");
    }

    #[test]
    fn pointers_that_are_null_misaligned_or_too_long_are_errors() {
        let numbers = [1_u32, 2, 3];
        // SAFETY: each pointer is null, misaligned, or points to the three numbers; no call reads beyond them.
        unsafe {
            assert_eq!(elements(numbers.as_ptr(), 3, "n").unwrap(), numbers);
            assert!(
                elements::<u32>(std::ptr::null(), 0, "n")
                    .unwrap()
                    .is_empty()
            );
            let null = elements::<u32>(std::ptr::null(), 1, "n");
            assert!(matches!(null, Err(BindingError::Null("n"))));
            let odd = numbers.as_ptr().cast::<u8>().add(1).cast::<u32>();
            assert!(matches!(
                elements(odd, 1, "n"),
                Err(BindingError::Argument { .. })
            ));
            assert!(matches!(
                value(odd, "n"),
                Err(BindingError::Argument { .. })
            ));
            let long = elements(numbers.as_ptr(), usize::MAX / 2, "n");
            assert!(matches!(long, Err(BindingError::Argument { .. })));
            assert!(matches!(
                value::<u32>(std::ptr::null(), "n"),
                Err(BindingError::Null("n"))
            ));
        }
    }

    #[test]
    fn a_buffer_that_is_too_small_is_not_written() {
        let mut buffer = [0_u32; 2];
        // SAFETY: the buffer has as many elements as the calls say, or the pointer is null.
        unsafe {
            let small = copy_out(buffer.as_mut_ptr(), 2, &[1, 2, 3], "n");
            let error = small.expect_err("three do not fit");
            assert_eq!(error.to_string(), "the buffer has 2 elements and needs 3");
            assert_eq!(buffer, [0, 0]);
            copy_out(buffer.as_mut_ptr(), 2, &[1, 2], "n").unwrap();
            assert!(copy_out::<u32>(std::ptr::null_mut(), 2, &[1], "n").is_err());
            copy_out::<u32>(std::ptr::null_mut(), 0, &[], "n").unwrap();
            write_if_wanted::<u32>(std::ptr::null_mut(), 1, "n").unwrap();
            assert!(write::<u32>(std::ptr::null_mut(), 1, "n").is_err());
        }
        assert_eq!(buffer, [1, 2]);
    }

    #[test]
    fn texts_are_read_if_they_are_utf_8() {
        // SAFETY: each text ends with a zero byte, or the pointer is null.
        unsafe {
            assert_eq!(text(c"pit".as_ptr(), "scene").unwrap(), "pit");
            assert!(text(std::ptr::null(), "scene").is_err());
            let broken = text(c"\xff".as_ptr(), "scene").expect_err("not UTF-8");
            assert_eq!(broken.to_string(), "scene must be text in UTF-8");
            assert_eq!(optional_text(std::ptr::null(), "token").unwrap(), None);
        }
    }

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
        let call = AssertUnwindSafe(|| table.with::<()>(number, |()| panic!("half done")));
        assert!(catch_unwind(call).is_err());
        assert_eq!(
            kind(table.with(number, |()| Ok(()))),
            Some(ErrorKind::Fault)
        );
        assert!(table.remove(number).is_ok());
    }
}
