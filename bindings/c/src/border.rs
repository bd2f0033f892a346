//! The border between C and Rust: panics stop, pointers become references.
//!
//! Every function that C calls goes through [`guard`]. All other files take pointers only by the functions of this one.

use std::any::Any;
use std::ffi::{CStr, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};

use rhumb_bindings::BindingError;

use crate::status::{RhumbCode, keep_error};

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::status::rhumb_last_error;

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
}
