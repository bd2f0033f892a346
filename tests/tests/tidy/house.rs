//! The files of the repository, as they are on the disk.
//!
//! It reads files and checks nothing. Build outputs of cargo and the benches are left out.

use std::fs;
use std::path::{Path, PathBuf};

use crate::code;

/// One file of the repository.
pub(crate) struct File {
    /// Path from the root, with slashes.
    pub(crate) path: String,
    /// Its text; empty if it is not text.
    pub(crate) text: String,
}

impl File {
    /// True if its path begins with one of these.
    pub(crate) fn is_in(&self, beginnings: &[&str]) -> bool {
        beginnings
            .iter()
            .any(|beginning| self.path.starts_with(beginning))
    }

    pub(crate) fn is_rust(&self) -> bool {
        self.path.ends_with(".rs")
    }

    /// True if it is test code: a file of tests, or of the package of tests.
    pub(crate) fn is_test(&self) -> bool {
        self.path.starts_with("tests/") || self.path.contains("/tests/")
    }

    /// The code without comments and strings, with the same lines.
    pub(crate) fn code(&self) -> String {
        code::without_text(&self.text)
    }
}

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package
        .parent()
        .expect("this package is in the repository")
        .to_owned()
}

/// Folders with generated content.
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
    let entries = fs::read_dir(folder).expect("reading the repository");
    for entry in entries {
        let entry = entry.expect("reading the repository");
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if path.is_empty() {
            name.clone()
        } else {
            format!("{path}/{name}")
        };
        if entry.path().is_symlink() {
            // Its files are read in the folder that it names.
            continue;
        }
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

/// Fails with all violations of a rule, if there are any.
pub(crate) fn report(rule: &str, violations: &[String]) {
    let count = violations.len();
    assert!(
        count == 0,
        "{rule}: broken {count} times\n  {}\n",
        violations.join("\n  ")
    );
}
