//! The files of the house, as they lie on the disk.
//!
//! Reads; judges nothing. What cargo and the benches leave behind is no part of the house.

use std::fs;
use std::path::{Path, PathBuf};

use crate::code;

/// One file of the house.
pub(crate) struct File {
    /// From the root, with slashes.
    pub(crate) path: String,
    /// As it stands; empty where it is not text.
    pub(crate) text: String,
}

impl File {
    /// Whether it lies in a folder, or is one of several files named by their beginning.
    pub(crate) fn is_in(&self, beginnings: &[&str]) -> bool {
        beginnings
            .iter()
            .any(|beginning| self.path.starts_with(beginning))
    }

    pub(crate) fn is_rust(&self) -> bool {
        self.path.ends_with(".rs")
    }

    /// Whether it only proves: tests, and the package of tests.
    pub(crate) fn is_test(&self) -> bool {
        self.path.starts_with("tests/") || self.path.contains("/tests/")
    }

    /// The code alone, line by line as it was.
    pub(crate) fn code(&self) -> String {
        code::without_words(&self.text)
    }
}

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package
        .parent()
        .expect("this package lies in the root")
        .to_owned()
}

/// Folders that are made, not written.
const MADE: [&str; 5] = [
    "target",
    "results",
    ".git",
    "__pycache__",
    "proptest-regressions",
];

/// Every file, in order of path.
pub(crate) fn files() -> Vec<File> {
    let mut files = Vec::new();
    walk(&root(), "", &mut files);
    files.sort_by(|a, b| a.path.cmp(&b.path));
    files
}

/// Every Rust source, in order of path.
pub(crate) fn sources() -> Vec<File> {
    files().into_iter().filter(File::is_rust).collect()
}

fn walk(folder: &Path, path: &str, files: &mut Vec<File>) {
    let entries = fs::read_dir(folder).expect("the house can be read");
    for entry in entries {
        let entry = entry.expect("the house can be read");
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if path.is_empty() {
            name.clone()
        } else {
            format!("{path}/{name}")
        };
        if entry.path().is_dir() {
            if !MADE.contains(&name.as_str()) {
                walk(&entry.path(), &path, files);
            }
        } else {
            let text = fs::read_to_string(entry.path()).unwrap_or_default();
            files.push(File { path, text });
        }
    }
}

/// Fails with every violation of a rule, or does nothing.
pub(crate) fn report(rule: &str, violations: &[String]) {
    let count = violations.len();
    assert!(
        count == 0,
        "{rule}: broken {count} times\n  {}\n",
        violations.join("\n  ")
    );
}
