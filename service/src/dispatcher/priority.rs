//! Priority of a thread, as the system knows it.

use std::sync::{Arc, OnceLock};

/// The system's number of a thread, once it runs.
#[cfg(target_os = "linux")]
pub(super) type ThreadId = Arc<OnceLock<rustix::process::Pid>>;

/// The system's number of a thread, where it is not known.
#[cfg(not(target_os = "linux"))]
pub(super) type ThreadId = Arc<OnceLock<()>>;

/// Notes the number of the calling thread.
#[cfg(target_os = "linux")]
pub(super) fn note(id: &ThreadId) {
    id.get_or_init(rustix::thread::gettid);
}

/// Notes nothing: this system's number is not used.
#[cfg(not(target_os = "linux"))]
pub(super) fn note(_: &ThreadId) {}

/// Gives a thread the lowest priority: it gets the processor time that no other thread wants.
#[cfg(target_os = "linux")]
pub(super) fn lower(id: &ThreadId) {
    /// The lowest.
    const NICE: i32 = 19;
    // On Linux the call concerns the one thread.
    let lowered = rustix::process::setpriority_process(id.get().copied(), NICE);
    if let Err(cause) = lowered {
        tracing::warn!(%cause, "cannot lower the priority of a quarantined thread");
    }
}

/// Does nothing: this system has no such call.
#[cfg(not(target_os = "linux"))]
pub(super) fn lower(_: &ThreadId) {}
