//! Values as text: numbers, rows of cells, indented JSON.
//!
//! For a terminal, for Markdown, and for the files of results.

use serde::Serialize;

/// Titles and rows as a Markdown table.
pub fn markdown(rows: &[Vec<String>]) -> String {
    let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
    let Some((titles, rows)) = rows.split_first() else {
        return String::new();
    };
    let numbers = "|---:".repeat(titles.len().saturating_sub(1));
    let rows: String = rows.iter().map(line).collect();
    format!("{}|---{numbers}|\n{rows}", line(titles))
}

/// Rows with aligned columns: the first to the left, the others to the right.
pub fn aligned(rows: &[Vec<String>]) -> String {
    let width = |column: usize| {
        let lengths = rows.iter().map(|row| row[column].chars().count());
        lengths.max().unwrap_or(0)
    };
    let widths: Vec<_> = (0..rows.first().map_or(0, Vec::len)).map(width).collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (place, (cell, width)) in row.iter().zip(&widths).enumerate() {
            line.push_str(&match place {
                0 => format!("{cell:<width$}"),
                _ => format!("  {cell:>width$}"),
            });
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// Cell of a figure without meaning.
pub(super) fn dash() -> String {
    "–".to_owned()
}

/// A number with three significant digits, never in powers of ten.
pub fn number(value: Option<f64>) -> String {
    match value {
        Some(value) if !value.is_finite() => dash(),
        Some(0.0) => "0".to_owned(),
        Some(value) if value.abs() >= 99.95 => grouped(value),
        Some(value) if value.abs() >= 9.995 => format!("{value:.1}"),
        Some(value) if value.abs() >= 0.9995 => format!("{value:.2}"),
        Some(value) => format!("{value:.3}"),
        None => dash(),
    }
}

/// A whole number with a comma before every three digits.
fn grouped(value: f64) -> String {
    let digits = format!("{value:.0}");
    let mut text = String::new();
    for (place, digit) in digits.chars().enumerate() {
        let left = digits.len() - place;
        if place > 0 && left % 3 == 0 && !text.ends_with('-') {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// The text of a value, with a line end.
///
/// # Errors
/// An error of `serde_json`: a map has keys that are no texts.
pub(crate) fn pretty_json(value: &impl Serialize) -> serde_json::Result<String> {
    let mut text = serde_json::to_string_pretty(value)?;
    text.push('\n');
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::number;

    #[test]
    fn a_number_shows_three_digits_or_all_before_the_point() {
        let shown = [
            0.0,
            0.0126,
            0.9999,
            9.999,
            99.96,
            123.4,
            1_234.0,
            1_234_567.0,
        ]
        .map(|n| number(Some(n)));
        let expected = [
            "0",
            "0.013",
            "1.00",
            "10.0",
            "100",
            "123",
            "1,234",
            "1,234,567",
        ];
        assert_eq!(shown, expected);
        assert_eq!(number(None), number(Some(f64::NAN)));
    }
}
