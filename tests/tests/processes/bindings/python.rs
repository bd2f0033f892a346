//! The Python package: its examples, the common script, its own tests.
//!
//! `RHUMB_TEST_PYTHON` names an interpreter that has NumPy and pytest; `python3` otherwise.

use std::path::Path;
use std::process::Command;

use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use super::script::expected;
use super::{has_all, libraries, root, run, run_well};
use crate::SERVER;

/// The package, laid out as an installed one.
pub(super) struct Package {
    folder: TempDir,
    interpreter: String,
}

impl Package {
    /// `None`, with a line that says so, if there is no interpreter with what the package and its tests need.
    pub(super) fn new() -> Option<Self> {
        let interpreter =
            std::env::var("RHUMB_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let mut imports = Command::new(&interpreter);
        imports.args(["-c", "import numpy, pytest"]);
        let is_there = imports.output().is_ok_and(|output| output.status.success());
        if !has_all("Python with numpy and pytest", is_there) {
            return None;
        }
        let folder = TempDir::new().expect("a folder for the package");
        let package = folder.path().join("rhumb");
        std::fs::create_dir(&package).expect("a folder for the package");
        let sources = root().join("bindings/python/python/rhumb");
        for entry in std::fs::read_dir(sources).expect("the package's sources") {
            let entry = entry.expect("a source");
            if entry.path().is_file() {
                std::fs::copy(entry.path(), package.join(entry.file_name())).expect("a copy");
            }
        }
        let native = libraries().join("librhumb_python.so");
        std::fs::copy(native, package.join("_native.abi3.so")).expect("cargo built the module");
        Some(Self {
            folder,
            interpreter,
        })
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.interpreter);
        command.env("PYTHONPATH", self.folder.path());
        command.env("PYTHONDONTWRITEBYTECODE", "1");
        command
    }

    /// Runs a program with these arguments; returns what it wrote.
    pub(super) fn run_on(&self, program: &str, arguments: &[String]) -> String {
        let program = root().join("bindings/python").join(program);
        run_well(self.command().arg(program).args(arguments))
    }

    fn run_with(&self, program: &str, server: &ServerProcess) -> String {
        let arguments = [server.address.to_string(), server.fingerprint.to_string()];
        let program = root().join("bindings/python").join(program);
        run_well(self.command().arg(program).args(arguments))
    }
}

#[test]
fn the_examples_in_python_drop_a_ball_and_push_a_box() {
    let Some(package) = Package::new() else {
        return;
    };
    let server = SERVER.serve_without_log("127.0.0.1:0");
    let out = package.run_with("examples/drop.py", &server);
    assert_eq!(out.lines().count(), 180, "{out}");
    assert!(out.contains("\ntick 180: 0.000 0.5"), "{out}");
    let out = package.run_with("examples/push_env.py", &server);
    assert_eq!(out.lines().count(), 3, "{out}");
    assert!(out.contains("box within 0.005 m"), "{out}");
}

#[test]
fn the_script_in_python_ends_with_the_hash_of_the_script_in_rust() {
    let Some(package) = Package::new() else {
        return;
    };
    let server = SERVER.serve_without_log("127.0.0.1:0");
    let expected = expected(&server).line();
    assert_eq!(package.run_with("tests/script.py", &server), expected);
}

#[test]
fn the_tests_of_the_package_pass() {
    let Some(package) = Package::new() else {
        return;
    };
    let tests: &Path = &root().join("bindings/python/tests");
    let mut pytest = package.command();
    pytest
        .args(["-m", "pytest", "-q", "-p", "no:cacheprovider"])
        .arg(tests);
    let ended = run(pytest.env("RHUMB_TEST_SERVER", SERVER.0));
    assert_eq!(ended.code, Some(0), "{}{}", ended.out, ended.log);
    println!("{}", ended.out);
}
