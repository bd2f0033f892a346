//! Prints the golden vectors of packets; `--write` writes them and the tables.
//!
//! The cases are in `accepted` and `refused`, their form in `document`.

mod accepted;
mod document;
mod named_packet;
mod plain;
mod refused;
mod rng;

use std::io::{self, Write};
use std::path::Path;

fn main() -> io::Result<()> {
    let text = document::vectors(&accepted::cases(), &refused::cases(), &accepted::covered());
    if std::env::args().any(|argument| argument == "--write") {
        let spec = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec");
        std::fs::create_dir_all(spec.join("tables"))?;
        std::fs::write(spec.join("tables/packets.json"), document::tables())?;
        return std::fs::write(spec.join("vectors/packets.json"), text);
    }
    io::stdout().write_all(text.as_bytes())
}
