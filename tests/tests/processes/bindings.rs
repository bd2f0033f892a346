//! Programs in other languages, beside a server process.
//!
//! Each test compiles or runs what is in `bindings/` against the libraries that cargo built for this package. A language
//! whose tools the system lacks is left out with a line that says so, unless `RHUMB_TEST_LANGUAGES` is `all`.

mod c;
mod csharp;
mod engines;
mod opensim;
mod python;
mod script;
mod shown;

use std::path::{Path, PathBuf};
use std::process::Command;

use rhumb_tests::Ended;

/// The root of the repository.
fn root() -> PathBuf {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().expect("the repository").to_owned()
}

/// The folder in which cargo left the libraries that this package depends on.
fn libraries() -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test");
    test.parent().expect("the folder of this test").to_owned()
}

/// Runs a command to its end.
fn run(command: &mut Command) -> Ended {
    let output = command.output();
    let output = output.unwrap_or_else(|error| panic!("{command:?}: {error}"));
    Ended {
        code: output.status.code(),
        out: String::from_utf8_lossy(&output.stdout).into_owned(),
        log: String::from_utf8_lossy(&output.stderr).into_owned(),
    }
}

/// Runs a command that must succeed; returns what it wrote.
fn run_well(command: &mut Command) -> String {
    let ended = run(command);
    assert_eq!(
        ended.code,
        Some(0),
        "{command:?}\n{}{}",
        ended.out,
        ended.log
    );
    ended.out
}

/// True if the system has a tool.
fn has(tool: &str) -> bool {
    has_all(tool, Command::new(tool).arg("--version").output().is_ok())
}

/// The same for several things. If they are not there, a line says so, or the test fails where all must be there.
fn has_all(what: &str, are_there: bool) -> bool {
    if !are_there {
        let all = std::env::var("RHUMB_TEST_LANGUAGES").is_ok_and(|which| which == "all");
        assert!(!all, "{what}: needed and not installed");
        eprintln!("{what}: not installed, left out");
    }
    are_there
}
