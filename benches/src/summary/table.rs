//! The runs as an aligned table, for a terminal or for Markdown.
//!
//! Computes nothing but ratios between figures of the summary.

use std::fmt;

use super::columns::{Column, columns};
use super::{RunFigures, Summary};

/// Shown by `Display`: a line of titles, one line per run, then one per failed replay.
#[derive(Clone, Copy, Debug)]
pub struct SummaryTable<'a> {
    summary: &'a Summary,
}

impl<'a> SummaryTable<'a> {
    pub(crate) const fn new(summary: &'a Summary) -> Self {
        Self { summary }
    }

    /// The same cells as a Markdown table.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let columns = columns(&self.summary.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        let mut text = markdown(&rows);
        let mut before = "\n";
        for replay in &self.summary.unfinished {
            text.push_str(&format!("{before}- Failed: {replay}\n"));
            before = "";
        }
        text
    }

    fn rows(&self, columns: &[Column]) -> Vec<Vec<String>> {
        let runs = &self.summary.runs;
        let cells = |run| {
            columns
                .iter()
                .map(|column| (column.cell)(run, runs))
                .collect()
        };
        runs.iter().map(cells).collect()
    }
}

/// Reduction of each run against naive: titles, then a row per run.
pub(crate) fn ratios(runs: &[RunFigures]) -> Vec<Vec<String>> {
    let titles = [
        "mode",
        "bodies",
        "payload",
        "with headers",
        "payload, first 5 s",
        "with headers, first 5 s",
    ];
    let mut rows = vec![titles.map(str::to_owned).to_vec()];
    for run in runs {
        if let Some(less) = run.less_than_naive {
            let ratios = [
                less.payload,
                less.with_headers,
                less.payload_first,
                less.with_headers_first,
            ];
            let mut row = vec![run.mode.clone(), run.bodies.to_string()];
            row.extend(ratios.map(|ratio| number(Some(ratio))));
            rows.push(row);
        }
    }
    rows
}

/// Rates down after the first seconds, as a scene comes to rest: titles, then a row per run.
pub(crate) fn later(runs: &[RunFigures]) -> Vec<Vec<String>> {
    let titles = ["mode", "bodies", "payload, B/s", "with headers, B/s"];
    let mut rows = vec![titles.map(str::to_owned).to_vec()];
    for run in runs {
        let (Some(first), Some(payload_kbps)) = (run.first_seconds, run.payload_kbps_down) else {
            continue;
        };
        let (Some(payload), Some(bytes)) = (run.payload_bytes_down, run.bytes_down) else {
            continue;
        };
        // Both rates cover the whole run.
        let all_s = payload as f64 * 8.0 / (payload_kbps * 1e3);
        let left_s = all_s - first.seconds;
        let each = |all: u64, first: u64| (left_s > 0.0).then(|| (all - first) as f64 / left_s);
        rows.push(vec![
            run.mode.clone(),
            run.bodies.to_string(),
            number(each(payload, first.payload_bytes_down)),
            number(each(bytes, first.bytes_down)),
        ]);
    }
    rows
}

fn titles(columns: &[Column]) -> Vec<String> {
    columns
        .iter()
        .map(|column| column.short.to_owned())
        .collect()
}

impl fmt::Display for SummaryTable<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let columns = columns(&self.summary.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        f.write_str(&aligned(&rows))?;
        let mut unfinished = self.summary.unfinished.iter();
        unfinished.try_for_each(|replay| writeln!(f, "failed: {replay}"))
    }
}

/// Titles and rows as a Markdown table.
pub(crate) fn markdown(rows: &[Vec<String>]) -> String {
    let line = |row: &Vec<String>| format!("| {} |\n", row.join(" | "));
    let Some((titles, rows)) = rows.split_first() else {
        return String::new();
    };
    let numbers = "|---:".repeat(titles.len().saturating_sub(1));
    let rows: String = rows.iter().map(line).collect();
    format!("{}|---{numbers}|\n{rows}", line(titles))
}

/// Rows with aligned columns: the first to the left, the others to the right.
pub(crate) fn aligned(rows: &[Vec<String>]) -> String {
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
pub(crate) fn number(value: Option<f64>) -> String {
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
