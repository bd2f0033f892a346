//! Values as the indented JSON of result files.

use serde::Serialize;

/// The text of a value, with a line end.
///
/// # Errors
///
/// As `serde_json`: a map whose keys are no texts.
pub(crate) fn pretty_json(value: &impl Serialize) -> serde_json::Result<String> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    Ok(text)
}
