//! Builds `paper.md` and `paper.html`: tables and figures of the paper.

use std::fmt::Write as _;

use super::experiment::PaperResults;
use super::figures::{self, PaperFigure};
use super::findings;
use super::table::Table;
use super::tables;
use crate::report::{STYLE, escape};

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
pub(super) fn markdown(results: &PaperResults) -> String {
    let mut text = format!(
        "# The paper's experiment, run again\n\n`{}`\n\n",
        results.command
    );
    for sentence in findings::sentences(results) {
        let _ = writeln!(text, "- {sentence}");
    }
    for table in all_tables(results) {
        let _ = write!(text, "\n## {}\n\n{}", table.title, table.to_markdown());
    }
    text
}

/// The text of `paper.html`, which is self-contained.
pub(super) fn html(results: &PaperResults) -> String {
    let mut body = format!("<pre>{}</pre>\n<ul>\n", escape(&results.command));
    for sentence in findings::sentences(results) {
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

/// A self-contained page.
pub(super) fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n"
    )
}

/// A figure with its legend.
pub(super) fn figure_html(figure: &PaperFigure) -> String {
    let mut text = format!("<h3>{}</h3>\n<div class=\"legend\">", escape(figure.title));
    for (color, label) in &figure.keys {
        let hue = format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2);
        let _ = write!(
            text,
            "<span class=\"key\" style=\"--own: {hue}\">{}</span>",
            escape(label)
        );
    }
    let svg = figure.svg.replacen("<svg ", "<svg role=\"img\" ", 1);
    let _ = writeln!(
        text,
        "</div>\n<figure aria-label=\"{}\">{svg}</figure>",
        escape(figure.title)
    );
    text
}
