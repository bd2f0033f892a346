//! Writes `include/rhumb.h` anew from the sources.

use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml"))?;
    let bindings = cbindgen::generate_with_config(folder, config)?;
    bindings.write_to_file(folder.join("include/rhumb.h"));
    Ok(())
}
