//! The runs as an aligned table, for a terminal or for Markdown.
//!
//! Computes nothing but ratios between the figures of the summary.

use std::fmt;

use super::{RunFigures, Summary};

const COLUMNS: [&str; 11] = [
    "mode", "bodies", "kbit/s", "naive/", "upd/s", "p99 mm", "max mm", "over", "frame ms",
    "/integr", "step ms",
];

/// Shown by `Display`; one line per run under one line of titles.
#[derive(Clone, Copy, Debug)]
pub struct Table<'a> {
    summary: &'a Summary,
}

impl<'a> Table<'a> {
    pub(super) const fn new(summary: &'a Summary) -> Self {
        Self { summary }
    }

    /// The same cells as a table in Markdown.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let mut text = format!("| {} |\n|---", COLUMNS.join(" | "));
        text.push_str(&"|---:".repeat(COLUMNS.len() - 1));
        text.push_str("|\n");
        for cells in self.rows() {
            text.push_str(&format!("| {} |\n", cells.join(" | ")));
        }
        text
    }

    fn rows(&self) -> Vec<[String; COLUMNS.len()]> {
        let runs = &self.summary.runs;
        runs.iter().map(|run| cells(run, runs)).collect()
    }
}

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = self.rows();
        let widths: [usize; COLUMNS.len()] = std::array::from_fn(|column| {
            let longest = rows.iter().map(|row| row[column].chars().count()).max();
            longest.unwrap_or(0).max(COLUMNS[column].len())
        });
        let titles = COLUMNS.map(str::to_owned);
        for row in std::iter::once(&titles).chain(&rows) {
            let [first, rest @ ..] = row;
            let mut line = format!("{first:<0$}", widths[0]);
            for (cell, width) in rest.iter().zip(&widths[1..]) {
                line.push_str(&format!("  {cell:>width$}"));
            }
            writeln!(f, "{}", line.trim_end())?;
        }
        Ok(())
    }
}

/// What stands in the columns for a run; a dash for what has no meaning.
fn cells(run: &RunFigures, runs: &[RunFigures]) -> [String; COLUMNS.len()] {
    let kbps = run.mean_kbps_down;
    let naive = run.beside(runs, "naive").and_then(|run| run.mean_kbps_down);
    let frame = run.frame_ms.map(|ms| ms.p50);
    let integrated = run.beside(runs, "integrated").and_then(|run| run.frame_ms);
    let error_mm =
        |of: fn(&super::Errors) -> f64| run.surface_error_m.as_ref().map(|e| 1e3 * of(e));
    [
        run.mode.clone(),
        run.bodies.to_string(),
        number(kbps),
        number(naive.zip(kbps).map(|(naive, own)| naive / own)),
        number(run.updates_per_second()),
        number(error_mm(|errors| errors.p99)),
        number(error_mm(|errors| errors.max)),
        run.over_tolerance
            .as_ref()
            .map_or_else(dash, |over| over.count.to_string()),
        number(frame),
        number(frame.zip(integrated).map(|(own, base)| own / base.p50)),
        number(Some(run.step_ms.p50)),
    ]
}

fn dash() -> String {
    "–".to_owned()
}

/// Three digits that count, never in powers of ten.
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
