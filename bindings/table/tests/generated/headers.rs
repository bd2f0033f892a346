//! The sources of rhumb-c, as declarations of C and of C#.

use std::error::Error;
use std::path::Path;

/// The header, below the folder of bindings.
pub(crate) const HEADER: &str = "c/include/rhumb.h";
/// The imports of C#, below the folder of bindings.
pub(crate) const IMPORTS: &str = "csharp/src/Native.g.cs";

/// Sources with functions or types that cross the border.
const SOURCES: [&str; 11] = [
    "border",
    "kinds",
    "descriptions",
    "connection",
    "scene",
    "cells",
    "generated",
    "commands",
    "feeding",
    "files",
    "answers",
];

/// Enumerations that only fields of type `u32` hold.
const ENUMERATIONS: [&str; 15] = [
    "RhumbCoordinates",
    "RhumbJoinCondition",
    "RhumbStepping",
    "RhumbRefusals",
    "RhumbBodyKind",
    "RhumbSleep",
    "RhumbEdges",
    "RhumbShapeKind",
    "RhumbJointKind",
    "RhumbJumpFrom",
    "RhumbCommandKind",
    "RhumbQueryKind",
    "RhumbEventKind",
    "RhumbRequestKind",
    "RhumbCellState",
];

/// The folder of bindings.
pub(crate) fn root() -> &'static Path {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    own.parent().expect("the folder of bindings")
}

/// The header of C.
pub(crate) fn header() -> Result<String, Box<dyn Error>> {
    let folder = root().join("c");
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml"))?;
    let bindings = cbindgen::generate_with_config(folder, config)?;
    let mut header = Vec::new();
    bindings.write(&mut header);
    Ok(String::from_utf8(header)?)
}

/// The imports of C#.
pub(crate) fn imports() -> Result<String, Box<dyn Error>> {
    let mut builder = csbindgen::Builder::default()
        .csharp_dll_name("rhumb")
        .csharp_namespace("Rhumb")
        .csharp_class_name("Native")
        .csharp_class_accessibility("public")
        .csharp_file_header(
            "// Functions and structs of rhumb.h for C#. Do not edit: see bindings/c.",
        )
        // Mono 6.8 does not know the names nint and nuint.
        .csharp_use_nint_types(false)
        .csharp_generate_const_filter(|name| name.starts_with("RHUMB_EVENTS_"))
        .always_included_types(ENUMERATIONS);
    for source in SOURCES {
        builder = builder.input_extern_file(root().join(format!("c/src/{source}.rs")));
    }
    let folder = tempfile::tempdir()?;
    let file = folder.path().join("Native.g.cs");
    builder.generate_csharp_file(&file)?;
    Ok(std::fs::read_to_string(file)?)
}
