//! Descriptions of the machine and the build, for comparing results.

use std::fs::DirEntry;
use std::path::Path;
use std::thread::available_parallelism;

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
}
