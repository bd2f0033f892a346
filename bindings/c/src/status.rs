//! Result codes, the sentence of the last error, and the version.

use std::cell::RefCell;
use std::ffi::{CString, c_char};

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
pub(crate) fn keep_error(error: &BindingError) {
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
