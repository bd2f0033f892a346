//! The files of golden vectors.

use std::path::{Path, PathBuf};

use serde_json::Value;

/// Where golden vectors lie.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors")
}

/// A file of golden vectors.
///
/// # Panics
///
/// When it is not there, or no JSON.
#[must_use]
pub fn golden(file: &str) -> Value {
    let text = std::fs::read_to_string(folder().join(file));
    let text = text.expect("the specification lies beside the crates");
    serde_json::from_str(&text).expect("vectors are JSON")
}
