//! Writes the header of C and the imports of C# anew.

mod generators;

use generators::{HEADER, IMPORTS, header, imports, root};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    std::fs::write(root().join(HEADER), header()?)?;
    std::fs::write(root().join(IMPORTS), imports()?)?;
    Ok(())
}
