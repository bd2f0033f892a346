//! Processor time, of the calling thread and of processes.

use std::time::{Duration, Instant};

/// A moment of the calling thread.
#[derive(Clone, Copy, Debug)]
pub struct ThreadMoment {
    wall: Instant,
    work_ns: Option<u64>,
}

impl ThreadMoment {
    /// The present moment.
    #[must_use]
    pub fn now() -> Self {
        Self {
            wall: Instant::now(),
            work_ns: work_ns(),
        }
    }

    /// Processor time of the calling thread since then, which other programs hardly change. Wall time where the system
    /// does not report it.
    #[must_use]
    pub fn elapsed(&self) -> Duration {
        let spent = self.work_ns.zip(work_ns());
        spent.map_or_else(
            || self.wall.elapsed(),
            |(before, now)| Duration::from_nanos(now - before),
        )
    }
}

/// Calls `work` and returns the time that it took, as [`ThreadMoment::elapsed`] counts.
pub(crate) fn time_of<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let begun = ThreadMoment::now();
    let done = work();
    (begun.elapsed(), done)
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

/// Processor time of a process and its children so far, microseconds; `None` if some of it cannot be read.
///
/// Threads and children that have ended count too. The system counts in clock ticks of 10 ms (USER_HZ is 100): over 1,800
/// ticks of a scene, some 10 µs a tick. Source: proc_pid_stat(5), fields 14 to 17.
#[cfg(target_os = "linux")]
pub(crate) fn worked_us(process: u32) -> Option<u64> {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let mut worked = clock_ticks(&stat)? * 10_000;
    for task in std::fs::read_dir(format!("/proc/{process}/task")).ok()? {
        let children = std::fs::read_to_string(task.ok()?.path().join("children")).ok()?;
        for child in children.split_whitespace() {
            worked += worked_us(child.parse().ok()?)?;
        }
    }
    Some(worked)
}

/// Memory of a process and its children now, bytes; `None` if some of it cannot be read. Source: proc_pid_status(5), VmRSS.
#[cfg(target_os = "linux")]
pub(crate) fn memory_bytes(process: u32) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let resident = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kilobytes: u64 = resident.trim().strip_suffix(" kB")?.parse().ok()?;
    let mut bytes = kilobytes * 1024;
    for task in std::fs::read_dir(format!("/proc/{process}/task")).ok()? {
        let children = std::fs::read_to_string(task.ok()?.path().join("children")).ok()?;
        for child in children.split_whitespace() {
            bytes += memory_bytes(child.parse().ok()?)?;
        }
    }
    Some(bytes)
}

/// Clock ticks of a process and of its children that have ended, user and system, from the contents of its `stat`.
#[cfg(target_os = "linux")]
fn clock_ticks(stat: &str) -> Option<u64> {
    // The second field is the program's name in parentheses, which may hold any character.
    let (_, fields) = stat.rsplit_once(')')?;
    let times: Vec<u64> = fields
        .split_whitespace()
        .skip(11)
        .take(4)
        .map_while(|time| time.parse().ok())
        .collect();
    (times.len() == 4).then(|| times.iter().sum())
}

/// The system does not say.
#[cfg(not(target_os = "linux"))]
pub(crate) fn worked_us(_: u32) -> Option<u64> {
    None
}

/// The system does not say.
#[cfg(not(target_os = "linux"))]
pub(crate) fn memory_bytes(_: u32) -> Option<u64> {
    None
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn the_times_of_a_process_are_found_behind_any_name() {
        let stat = "7 (a) b (c) S 1 7 7 0 -1 4194304 102 0 0 0 30 4 200 1000 20 0 1 0 4294182";
        assert_eq!(clock_ticks(stat), Some(1_234));
        assert_eq!(
            clock_ticks("7 (a) S 1 7 7 0 -1 4194304 102 0 0 0 30 4 200"),
            None
        );
        assert_eq!(
            clock_ticks("7 (a) S 1 7 7 0 -1 4194304 102 0 0 0 30 4 x 1000"),
            None
        );
    }
}
