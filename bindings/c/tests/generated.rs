//! The committed header and imports are what the sources say.
//!
//! `cargo run -p rhumb-c --example generate` writes them anew.

#[path = "../examples/generate/generators.rs"]
mod generators;

use generators::{HEADER, IMPORTS, header, imports, root};

fn compare(path: &str, generated: &str) {
    let committed = std::fs::read_to_string(root().join(path)).expect("the committed file");
    let lines = generated.lines().zip(committed.lines());
    let differing = lines.enumerate().find(|(_, (a, b))| a != b);
    let line = differing.map_or(1, |(place, _)| place + 1);
    assert!(
        generated == committed,
        "bindings/{path} differs from line {line} on: cargo run -p rhumb-c --example generate"
    );
}

#[test]
fn the_committed_header_of_c_is_generated_from_the_sources() {
    compare(HEADER, &header().unwrap());
}

#[test]
fn the_committed_imports_of_csharp_are_generated_from_the_sources() {
    compare(IMPORTS, &imports().unwrap());
}
