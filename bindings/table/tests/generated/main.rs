//! The committed files are what the table and the sources say.
//!
//! `UPDATE_VECTORS=1 cargo test -p rhumb-table` writes them anew.

mod headers;

use std::io::Write as _;
use std::process::{Command, Stdio};

use rhumb_table::table::Table;
use rhumb_table::{Output, outputs};

/// A Rust source as `cargo fmt` leaves it; `None`, with a line that says so, without rustfmt.
fn formatted(source: &str) -> Option<String> {
    let mut command = Command::new("rustfmt");
    let command = command.args(["--edition", "2024", "--emit", "stdout"]);
    let Ok(mut run) = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn() else {
        eprintln!("rustfmt: not installed, left out");
        return None;
    };
    let mut input = run.stdin.take().expect("a pipe");
    input
        .write_all(source.as_bytes())
        .expect("rustfmt reads it");
    drop(input);
    let output = run.wait_with_output().expect("rustfmt ends");
    let formatted = String::from_utf8(output.stdout).expect("it is text");
    // Without rustfmt's component, rustup's program of this name fails.
    let is_done = output.status.success() && !formatted.is_empty();
    assert!(
        is_done || source.is_empty() || !has_rustfmt(),
        "rustfmt refuses:\n{source}"
    );
    is_done.then_some(formatted)
}

fn has_rustfmt() -> bool {
    let version = Command::new("rustfmt").arg("--version").output();
    version.is_ok_and(|version| version.status.success())
}

/// Compares a file with what it has to be, or writes it.
fn compare(path: &str, generated: &str) {
    let file = headers::root().join(path);
    if std::env::var_os("UPDATE_VECTORS").is_some() {
        std::fs::write(&file, generated).expect("the checkout can be written");
    }
    let committed = std::fs::read_to_string(file).expect("the committed file");
    let lines = generated.lines().zip(committed.lines());
    let differing = lines.enumerate().find(|(_, (a, b))| a != b);
    let line = differing.map_or(1, |(place, _)| place + 1);
    assert!(
        generated == committed,
        "bindings/{path} differs from line {line} on: UPDATE_VECTORS=1 cargo test -p rhumb-table"
    );
}

/// One test, because the header is read out of files that come before it.
#[test]
fn the_committed_files_are_made_of_the_table_and_the_sources() {
    for Output { path, parts } in outputs(&Table::load()) {
        let committed = std::fs::read_to_string(headers::root().join(path)).unwrap_or_default();
        let whole = parts
            .into_iter()
            .fold(committed, |text, part| part.placed(&text));
        let is_rust = path.ends_with(".rs");
        let whole = if is_rust {
            formatted(&whole)
        } else {
            Some(whole)
        };
        if let Some(whole) = whole {
            compare(path, &whole);
        }
    }
    compare(headers::HEADER, &headers::header().unwrap());
    compare(headers::IMPORTS, &headers::imports().unwrap());
}
