//! Prints the golden vectors of the control stream; `--write` writes them.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let text = rhumb_tests::vectors::control();
    if std::env::args().any(|argument| argument == "--write") {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors/control.json");
        return std::fs::write(path, text);
    }
    println!("{text}");
    Ok(())
}
