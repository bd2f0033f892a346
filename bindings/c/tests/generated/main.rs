//! The committed header and imports are what the sources say.
//!
//! `UPDATE_VECTORS=1 cargo test -p rhumb-c --test generated` writes them anew.

mod generators;

use generators::{HEADER, IMPORTS, header, imports, root};

fn compare(path: &str, generated: &str) {
    let file = root().join(path);
    if std::env::var_os("UPDATE_VECTORS").is_some() {
        std::fs::write(&file, generated).expect("the checkout can be written");
    }
    let committed = std::fs::read_to_string(file).expect("the committed file");
    let lines = generated.lines().zip(committed.lines());
    let differing = lines.enumerate().find(|(_, (a, b))| a != b);
    let line = differing.map_or(1, |(place, _)| place + 1);
    assert!(
        generated == committed,
        "bindings/{path} differs from line {line} on: UPDATE_VECTORS=1 cargo test -p rhumb-c --test generated"
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
