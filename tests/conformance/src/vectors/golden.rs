//! The golden vectors of the specification, as this build embeds them.

use serde_json::Value;

/// A file of golden vectors, by name.
///
/// # Panics
///
/// When there is no such file.
#[must_use]
pub fn golden(file: &str) -> Value {
    let text = match file {
        "control.json" => include_str!("../../spec/vectors/control.json"),
        "packets.json" => include_str!("../../spec/vectors/packets.json"),
        "reckoning.json" => include_str!("../../spec/vectors/reckoning.json"),
        "scripted.json" => include_str!("../../spec/vectors/scripted.json"),
        "streams.json" => include_str!("../../spec/vectors/streams.json"),
        _ => panic!("the specification has no vectors {file}"),
    };
    serde_json::from_str(text).expect("vectors are JSON")
}
