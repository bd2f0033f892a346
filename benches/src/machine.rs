//! What machine this is, in a line that a reader can compare with another.

use std::thread::available_parallelism;

/// Processor, cores that this process may use, and system.
#[must_use]
pub(crate) fn describe() -> String {
    let processor = processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    format!("{processor}, {} cores, {}", cores(), std::env::consts::OS)
}

/// How many cores this process may use.
#[must_use]
pub(crate) fn cores() -> usize {
    available_parallelism().map_or(1, usize::from)
}

/// The processor's own name, where the system tells it.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    Some(name.trim().to_owned())
}
