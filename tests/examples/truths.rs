//! Prints bit-exact reference motions of some scenes; `--write` writes them.

use std::io::Write;
use std::path::Path;

use rhumb_tests::conformance::truths::truths;

fn main() -> std::io::Result<()> {
    let text = truths();
    if std::env::args().any(|argument| argument == "--write") {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("data");
        return std::fs::write(data.join("truths.json"), text);
    }
    std::io::stdout().write_all(text.as_bytes())
}
