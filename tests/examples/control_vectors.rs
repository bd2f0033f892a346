//! Prints golden vectors of messages and streams; `--write` writes them.

use std::io::Write;

use rhumb_tests::vectors::{control, folder, streams};

fn main() -> std::io::Result<()> {
    let write = std::env::args().any(|argument| argument == "--write");
    let vectors = folder();
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
