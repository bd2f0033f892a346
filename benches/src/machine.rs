//! What machine and what build this is, in lines to compare with others

use std::fs::DirEntry;
use std::path::Path;
use std::thread::available_parallelism;

use git_version::git_version;

/// Processor, cores that this process may use, accelerators that a driver names, and system.
#[must_use]
pub(crate) fn describe() -> String {
    let processor = processor().unwrap_or_else(|| std::env::consts::ARCH.to_owned());
    let cores = format!("{} cores", cores());
    let accelerators = accelerators(Path::new(ACCELERATORS));
    let parts = [processor, cores].into_iter().chain(accelerators);
    let parts = parts.chain([std::env::consts::OS.to_owned()]);
    parts.collect::<Vec<_>>().join(", ")
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
    value(&text, "model name")
}

/// Where a driver keeps a folder for each accelerator.
const ACCELERATORS: &str = "/proc/driver/nvidia/gpus";

/// The names of the accelerators of a folder, in order; none where there is no such driver.
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

/// What stands behind the colon of the first line that begins so.
fn value(text: &str, name: &str) -> Option<String> {
    let line = text.lines().find(|line| line.starts_with(name))?;
    let (_, value) = line.split_once(':')?;
    Some(value.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerators_are_named_as_their_driver_names_them() {
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
