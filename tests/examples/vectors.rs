//! Prints golden vectors of messages and streams; `--write` writes them.

use std::io::Write;
use std::path::Path;

use rhumb_tests::vectors::{control, streams};

fn main() -> std::io::Result<()> {
    let write = std::env::args().any(|argument| argument == "--write");
    let vectors = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors");
    for (name, text) in [
        ("control.json", control()),
        ("streams.json", streams::streams()),
    ] {
        if write {
            std::fs::write(vectors.join(name), text)?;
        } else {
            std::io::stdout().write_all(text.as_bytes())?;
        }
    }
    Ok(())
}
