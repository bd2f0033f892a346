//! Prints bit-exact reference motions of some scenes; `--write` writes them.

use std::io::Write;
use std::path::Path;

use rhumb_conformance::truths::{engine, truths};

fn main() -> std::io::Result<()> {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let lock = std::fs::read_to_string(package.join("../../Cargo.lock"))?;
    let text = truths(&engine(&lock));
    if std::env::args().any(|argument| argument == "--write") {
        return std::fs::write(package.join("data/truths.json"), text);
    }
    std::io::stdout().write_all(text.as_bytes())
}
