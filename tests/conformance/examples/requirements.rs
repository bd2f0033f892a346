//! Prints the table of requirements with the suite's columns.
//!
//! `--write` writes it.

use std::io::Write;
use std::path::Path;

use rhumb_conformance::coverage::table;

fn main() -> std::io::Result<()> {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../spec/tables/requirements.json");
    let text = table(&std::fs::read_to_string(&file)?);
    if std::env::args().any(|argument| argument == "--write") {
        return std::fs::write(file, text);
    }
    std::io::stdout().write_all(text.as_bytes())
}
