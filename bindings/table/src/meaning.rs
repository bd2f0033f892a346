//! The meaning of a field: a sentence with its unit and its bounds.

use crate::table::{CallField, FieldKind};
use crate::text::number;

/// The units in which a language has lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lengths {
    /// Metres.
    Metres,
    /// The unit of length of a scene's coordinates.
    OfScene,
}

/// The meaning of a field, with its unit and its bounds, without a full stop.
#[must_use]
pub fn meaning(field: &CallField, lengths: Lengths) -> String {
    let mut meaning = field.doc.clone();
    if field.is_turn && lengths == Lengths::OfScene {
        meaning += ", in left-handed coordinates to the right";
    }
    let unit = field.unit.as_deref().unwrap_or_default();
    let symbol = symbol(unit);
    let scaled = match lengths {
        Lengths::Metres => "",
        Lengths::OfScene => in_scene(unit),
    };
    if !scaled.is_empty() {
        meaning += &format!(", {scaled}");
    }
    let bounds = bounds(field);
    match (bounds.is_empty(), scaled.is_empty() && !symbol.is_empty()) {
        (false, _) if field.kind == FieldKind::Vector => {
            meaning += &format!(": {bounds} {symbol} along each axis");
        }
        (false, _) => meaning += &format!(": {bounds} {symbol}"),
        (true, true) => meaning += &format!(", {symbol}"),
        (true, false) => {}
    }
    meaning.trim_end().to_owned()
}

fn bounds(field: &CallField) -> String {
    match field.bounds {
        [Some(from), Some(to)] => format!("{} to {}", number(from), number(to)),
        [None, Some(to)] if field.kind == FieldKind::Vector => {
            format!("at most {}", number(to))
        }
        [None, Some(to)] => format!("{} to {}", number(-to), number(to)),
        _ => String::new(),
    }
}

/// A unit as a sentence has it.
#[must_use]
pub fn symbol(unit: &str) -> String {
    unit.replace('2', "²").replace(' ', "·")
}

/// A unit with a length in it, where the coordinates have their own.
fn in_scene(unit: &str) -> &'static str {
    match unit {
        "m" => "units of length",
        "m/s" => "units of length per second",
        "m/s2" => "units of length per s²",
        _ => "",
    }
}
