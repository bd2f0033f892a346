//! How much of the processor the calling thread has had.

/// Nanoseconds of work of the calling thread so far; `None` where the system does not tell.
#[cfg(target_os = "linux")]
pub(super) fn work_ns() -> Option<u64> {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).ok()?;
    let rest = u64::try_from(time.tv_nsec).ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(rest)
}

/// Nanoseconds of work of the calling thread so far; `None` where the system does not tell.
#[cfg(not(target_os = "linux"))]
pub(super) fn work_ns() -> Option<u64> {
    None
}
