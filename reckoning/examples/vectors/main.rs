//! Prints the golden vectors of reckoning, or writes them with `--write`.
//!
//! The cases are in `cases`, their form in `document`.

mod cases;
mod document;

use std::io::{self, Write};
use std::path::Path;

fn main() -> io::Result<()> {
    let text = cases::document();
    if std::env::args().any(|argument| argument == "--write") {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors/reckoning.json");
        return std::fs::write(path, text);
    }
    io::stdout().write_all(text.as_bytes())
}
