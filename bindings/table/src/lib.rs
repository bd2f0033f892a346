//! Writes what the bindings of all languages have of the protocol's table.
//!
//! `spec/tables/protocol.json` says which commands there are, what they are called, what their fields are, in which unit and
//! within which bounds. [`outputs`] names the files; `c`, `core`, `cpp`,
//! `csharp`, `godot`, `python` and `web` write them. Nothing here is part of a binding:
//! `UPDATE_VECTORS=1 cargo test -p rhumb-table` writes the files, and the same without it compares them.
#![forbid(unsafe_code)]

pub mod c;
pub mod core;
pub mod cpp;
pub mod csharp;
pub mod godot;
pub mod outputs;
pub mod python;
pub mod table;
pub mod text;
pub mod web;
