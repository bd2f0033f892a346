//! The runs as an aligned table, for a terminal or for Markdown.
//!
//! Computes nothing but ratios between figures of the summary.

use std::fmt;

use super::cells::{aligned, markdown, number};
use super::columns::{Column, columns};
use super::run_figures::RunFigures;
use super::unfinished::UnfinishedReplay;

/// Shown by `Display`: a line of titles, one line per run, then one per failed replay.
#[derive(Clone, Copy, Debug)]
pub struct SummaryTable<'a> {
    runs: &'a [RunFigures],
    unfinished: &'a [UnfinishedReplay],
}

impl<'a> SummaryTable<'a> {
    pub(crate) const fn new(runs: &'a [RunFigures], unfinished: &'a [UnfinishedReplay]) -> Self {
        Self { runs, unfinished }
    }

    /// The same cells as a Markdown table.
    #[must_use]
    pub fn to_markdown(&self) -> String {
        let columns = columns(self.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        let mut text = markdown(&rows);
        let mut before = "\n";
        for replay in self.unfinished {
            text.push_str(&format!("{before}- Failed: {replay}\n"));
            before = "";
        }
        text
    }

    fn rows(&self, columns: &[Column]) -> Vec<Vec<String>> {
        let runs = self.runs;
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
pub fn ratios(runs: &[RunFigures]) -> Vec<Vec<String>> {
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
pub fn later(runs: &[RunFigures]) -> Vec<Vec<String>> {
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
        let columns = columns(self.runs);
        let mut rows = vec![titles(&columns)];
        rows.extend(self.rows(&columns));
        f.write_str(&aligned(&rows))?;
        let mut unfinished = self.unfinished.iter();
        unfinished.try_for_each(|replay| writeln!(f, "failed: {replay}"))
    }
}
