//! Writes what the bindings of all languages have of the protocol's table.
//!
//! `spec/tables/protocol.json` says which commands there are, what they are called, what their fields are, in which unit and
//! within which bounds. [`outputs()`] names the files; `c`, `core`, `cpp`,
//! `csharp`, `godot`, `python` and `web` write them. Nothing here is part of a binding:
//! `UPDATE_VECTORS=1 cargo test -p rhumb-table` writes the files, and the same without it compares them.
#![forbid(unsafe_code)]

pub mod c;
pub mod core;
pub mod cpp;
pub mod csharp;
pub mod godot;
pub mod python;
pub mod table;
pub mod web;

use crate::table::{MadePart, Table};

/// A file, and what is made of it.
#[derive(Debug)]
pub struct Output {
    /// Its path below the folder of bindings.
    pub path: &'static str,
    /// The generated text.
    pub parts: Vec<MadePart>,
}

/// All files, in an order in which they can be made.
#[must_use]
pub fn outputs(table: &Table) -> Vec<Output> {
    let whole = |path, text| Output {
        path,
        parts: MadePart::whole(text),
    };
    vec![
        whole("core/src/generated.rs", core::generated(table)),
        whole("c/src/generated.rs", c::generated(table)),
        Output {
            path: "c/include/rhumb.hpp",
            parts: cpp::parts(table),
        },
        whole("csharp/src/Commands.g.cs", csharp::generated(table)),
        whole("python/src/generated.rs", python::generated(table)),
        Output {
            path: "python/python/rhumb/_native.pyi",
            parts: python::stubs(table),
        },
        whole("web/src/generated.rs", web::generated(table)),
        Output {
            path: "web/rhumb.d.ts",
            parts: web::types(table),
        },
        whole("godot/src/generated.rs", godot::generated(table)),
    ]
}
