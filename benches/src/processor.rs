//! Processor time of the calling thread.

use std::time::{Duration, Instant};

/// Calls `work` and returns the processor time of the calling thread that it took, which other programs hardly change.
/// Wall time where the system does not report it.
pub(crate) fn time_of<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let (begun, before) = (Instant::now(), work_ns());
    let done = work();
    let spent = before
        .zip(work_ns())
        .map(|(before, now)| Duration::from_nanos(now - before));
    (spent.unwrap_or_else(|| begun.elapsed()), done)
}

/// Processor time of the calling thread so far, nanoseconds; `None` where the system does not report it.
#[cfg(target_os = "linux")]
pub(crate) fn work_ns() -> Option<u64> {
    use rustix::time::{ClockId, clock_gettime};
    let time = clock_gettime(ClockId::ThreadCPUTime);
    let seconds = u64::try_from(time.tv_sec).ok()?;
    let rest = u64::try_from(time.tv_nsec).ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(rest)
}

/// Processor time of the calling thread so far, nanoseconds; `None` where the system does not report it.
#[cfg(not(target_os = "linux"))]
pub(crate) fn work_ns() -> Option<u64> {
    None
}
