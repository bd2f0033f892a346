//! The committed header is what the sources say.
//!
//! `cargo run -p rhumb-c --example header` writes it anew.

use std::path::Path;

#[test]
fn the_committed_header_is_generated_from_the_sources() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml")).unwrap();
    let bindings = cbindgen::generate_with_config(folder, config).unwrap();
    let mut generated = Vec::new();
    bindings.write(&mut generated);
    let generated = String::from_utf8(generated).unwrap();
    let committed = std::fs::read_to_string(folder.join("include/rhumb.h")).unwrap();
    let differing = generated
        .lines()
        .zip(committed.lines())
        .position(|(a, b)| a != b);
    assert!(
        generated == committed,
        "include/rhumb.h differs from line {:?} on: cargo run -p rhumb-c --example header",
        differing.map(|line| line + 1)
    );
}
