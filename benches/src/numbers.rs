//! Numbers of results: percentiles by nearest rank, and values as text.
//!
//! A percentile is never interpolated: every quantile is a measured value, so all readers compute the same one. Text is for
//! a terminal, for Markdown, and for the files of results: numbers, rows of cells, indented JSON.

use serde::Serialize;

/// Index of a percentile among `count` sorted values, counted from 0: the least whose share reaches it.
pub fn rank(percent: u32, count: usize) -> Option<usize> {
    let place = (count as u64 * u64::from(percent)).div_ceil(100).max(1);
    (count > 0).then(|| place as usize - 1)
}

/// A percentile of unsorted values; reorders them.
pub fn of_nanoseconds(values: &mut [u64], percent: u32) -> Option<u64> {
    let place = rank(percent, values.len())?;
    Some(*values.select_nth_unstable(place).1)
}

/// Values of at least zero; zeros are only counted, not stored.
#[derive(Debug, Default)]
pub struct WithZeros {
    values: Vec<f32>,
    zeros: u64,
}

impl WithZeros {
    /// Adds values and a count of zeros.
    pub fn extend(&mut self, values: &[f32], zeros: u32) {
        self.values.extend_from_slice(values);
        self.zeros += u64::from(zeros);
    }

    /// Number of values, zeros included.
    pub fn count(&self) -> u64 {
        self.values.len() as u64 + self.zeros
    }

    /// A percentile, or `None` without values.
    pub fn percentile(&mut self, percent: u32) -> Option<f64> {
        let place = rank(percent, self.count() as usize)? as u64;
        let Some(place) = place.checked_sub(self.zeros) else {
            return Some(0.0);
        };
        let (_, value, _) = self
            .values
            .select_nth_unstable_by(place as usize, f32::total_cmp);
        Some(f64::from(*value))
    }
}

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
pub(crate) fn dash() -> String {
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
    use super::*;

    #[test]
    fn a_percentile_is_one_of_the_values() {
        let mut hundred: Vec<u64> = (1..=100).rev().collect();
        for (percent, value) in [(0, 1), (50, 50), (99, 99), (100, 100)] {
            assert_eq!(of_nanoseconds(&mut hundred, percent), Some(value));
        }
        assert_eq!(of_nanoseconds(&mut [7], 99), Some(7));
        assert_eq!(of_nanoseconds(&mut [], 50), None);
    }

    #[test]
    fn zeros_count_without_being_stored() {
        let mut errors = WithZeros::default();
        assert_eq!(errors.percentile(50), None);
        errors.extend(&[0.5, 0.25], 2);
        assert_eq!(errors.count(), 4);
        assert_eq!(errors.percentile(50), Some(0.0));
        assert_eq!(errors.percentile(75), Some(0.25));
        assert_eq!(errors.percentile(100), Some(0.5));
    }

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
