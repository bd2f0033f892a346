//! Builds `paper.md` and `paper.html`: tables and figures of the paper.

use std::fmt::Write as _;

use super::figures;
use super::findings::sentences;
use super::page::{figure_html, page};
use super::results::PaperResults;
use super::table::Table;
use super::tables;
use rhumb_bench::report::escape;

/// All tables, in order.
fn all_tables(results: &PaperResults) -> Vec<Table> {
    vec![
        tables::aims(results),
        tables::sim_fps(results),
        tables::phys_ft(results),
        tables::degradation(results),
        tables::sustained(results),
        tables::paired(results),
        tables::tests_frame(results),
        tables::tests_fps(results),
        tables::stages(results),
        tables::traffic(results),
    ]
}

/// The text of `paper.md`.
pub(crate) fn markdown(results: &PaperResults) -> String {
    let mut text = format!(
        "# The paper's experiment, run again\n\n`{}`\n\n",
        results.command
    );
    for sentence in sentences(results) {
        let _ = writeln!(text, "- {sentence}");
    }
    for table in all_tables(results) {
        let _ = write!(text, "\n## {}\n\n{}", table.title, table.to_markdown());
    }
    text
}

/// The text of `paper.html`, which is self-contained.
pub(crate) fn html(results: &PaperResults) -> String {
    let mut body = format!("<pre>{}</pre>\n<ul>\n", escape(&results.command));
    for sentence in sentences(results) {
        let _ = writeln!(body, "<li>{}</li>", escape(&sentence));
    }
    body.push_str("</ul>\n");
    for figure in [figures::sim_fps(results), figures::phys_ft(results)] {
        body.push_str(&figure_html(&figure));
    }
    for table in all_tables(results) {
        body.push_str(&table.to_html());
    }
    page("The paper's experiment, run again", &body)
}
