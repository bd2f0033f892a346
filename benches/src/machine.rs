//! What machine and what build this is, in lines to compare with others

use std::thread::available_parallelism;

use git_version::git_version;

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

/// How this program was built, and from which commit where that is known.
#[must_use]
pub(crate) fn build() -> String {
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

/// The processor's own name, where the system tells it.
fn processor() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    let (_, name) = line.split_once(':')?;
    Some(name.trim().to_owned())
}
