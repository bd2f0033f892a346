//! The machine and the build, for comparing results, and processor time.
//!
//! Processor time is that of the calling thread, or of processes.

use std::fs::DirEntry;
use std::path::Path;
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use git_version::git_version;

/// Processor, cores available to this process, accelerators with a driver, and operating system.
#[must_use]
pub fn describe() -> String {
    let processor = processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    let cores = format!("{} cores", cores());
    let accelerators = accelerators(Path::new(ACCELERATORS));
    let parts = [processor, cores].into_iter().chain(accelerators);
    let parts = parts.chain([std::env::consts::OS.to_owned()]);
    parts.collect::<Vec<_>>().join(", ")
}

/// Cores that this process may use.
#[must_use]
pub fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// Build profile, version and, where known, the commit.
#[must_use]
pub fn build() -> String {
    let kind = if cfg!(debug_assertions) {
        "debug"
    } else {
        "release"
    };
    let commit = git_version!(
        args = ["--always", "--abbrev=12", "--dirty", "--exclude=*"],
        fallback = "of no repository"
    );
    let with = if cfg!(feature = "parallel") {
        ", with parallel"
    } else {
        ""
    };
    format!("{kind}, {} {commit}{with}", env!("CARGO_PKG_VERSION"))
}

/// The processor's name, where the operating system states it.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    value(&text, "model name")
}

/// Folder in which the driver keeps one folder per accelerator.
const ACCELERATORS: &str = "/proc/driver/nvidia/gpus";

/// Names of the accelerators in a folder, sorted; empty without such a driver.
fn accelerators(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let name = |entry: DirEntry| {
        let text = std::fs::read_to_string(entry.path().join("information")).ok()?;
        value(&text, "Model")
    };
    let mut names: Vec<String> = entries.filter_map(name).collect();
    names.sort_unstable();
    names
}

/// The text after the colon of the first line that begins with `name`.
fn value(text: &str, name: &str) -> Option<String> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    let (_, value) = line.split_once(':')?;
    Some(value.trim().to_owned())
}

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

/// Lowers the priority of the calling thread, and of those that it starts: others have the cores first.
#[cfg(target_os = "linux")]
pub(crate) fn lower_priority() {
    // On Linux the call concerns the one thread. A system that refuses it leaves the priority as it is.
    let _ = rustix::process::setpriority_process(None, 10);
}

/// The system has no such call.
#[cfg(not(target_os = "linux"))]
pub(crate) const fn lower_priority() {}

/// Processes that ran or waited for a processor, on average over the last minute; `None` where the system does not say.
/// Source: proc_loadavg(5).
pub(crate) fn load_average() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/loadavg").ok()?;
    text.split_whitespace().next()?.parse().ok()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerator_names_come_from_their_driver() {
        let folder = std::env::temp_dir().join(format!("rhumb-machine-{}", std::process::id()));
        for (bus, model) in [("0000:41:00.0", "NVIDIA H100 PCIe"), ("0000:01:00.0", "A")] {
            let of = folder.join(bus);
            std::fs::create_dir_all(&of).expect("the folder is ours");
            let text = format!("Model: \t\t {model}\nIRQ:   \t\t 1\n");
            std::fs::write(of.join("information"), text).expect("the folder is ours");
        }
        std::fs::create_dir_all(folder.join("empty")).expect("the folder is ours");
        assert_eq!(accelerators(&folder), ["A", "NVIDIA H100 PCIe"]);
        assert!(accelerators(&folder.join("none")).is_empty());
        std::fs::remove_dir_all(&folder).expect("the folder is ours");
    }

    #[cfg(target_os = "linux")]
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
