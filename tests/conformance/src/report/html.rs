//! A report as a self-contained HTML page: verdicts, failures, coverage.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use quick_xml::escape::escape;

use super::json::cites;
use super::results::Report;
use super::style::STYLE;
use crate::matrix::{Pairing, clients_of, rows};
use crate::run::Tried;

/// The report as HTML.
#[must_use]
pub fn html(report: &Report) -> String {
    let title = format!("Conformance of {}", escape(&report.subject));
    let mut page = head(&title);
    let word = if report.passed() {
        ("pass", "passed")
    } else {
        ("fail", "failed")
    };
    let config = report.config.as_ref().map(|config| format!("; {config}"));
    let config = config.unwrap_or_default();
    let _ = write!(
        page,
        "<h1>{title}</h1>\n<p class=\"{}\">{}</p>\n<p>{}{}{}</p>\n",
        word.0,
        word.1,
        escape(report.summary()),
        escape(config),
        if report.strict { ", strict" } else { "" },
    );
    pairs(&mut page, &report.pairs);
    failures(&mut page, report);
    page.push_str("<h2>Cases</h2>\n<table>\n");
    page.push_str("<tr><th>id</th><th>promise</th><th>verdict</th><th>closing</th><th>requirements</th></tr>\n");
    for result in &report.results {
        row(&mut page, result);
    }
    page.push_str("</table>\n");
    coverage(&mut page, report);
    page.push_str("</body>\n</html>\n");
    page
}

/// The start of a page, up to its body.
pub(crate) fn head(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
        <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
        <title>{title}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
    )
}

/// The matrix: a row for each server, a column for each client.
fn pairs(page: &mut String, pairs: &[Pairing]) {
    if pairs.is_empty() {
        return;
    }
    page.push_str("<h2>Clients with servers</h2>\n<table>\n<tr><th></th>");
    for client in clients_of(pairs) {
        let _ = write!(page, "<th>{}</th>", escape(client));
    }
    page.push_str("</tr>\n");
    for (server, row) in rows(pairs) {
        let _ = write!(page, "<tr><th>{}</th>", escape(server));
        for pair in row {
            let word = if pair.is_good() { "pass" } else { "fail" };
            let _ = write!(page, "<td class=\"{word}\">{pair}</td>");
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</table>\n");
}

fn row(page: &mut String, Tried { case, outcome }: &Tried) {
    let _ = writeln!(
        page,
        "<tr><td><code>{}</code></td><td>{}</td><td class=\"{}\">{}</td><td class=\"{}\">{}</td><td class=\"soft\">{}</td></tr>",
        escape(&case.id),
        escape(&case.name),
        outcome.verdict.word(),
        outcome.verdict.word(),
        outcome.closing.word(),
        escape(outcome.closing.to_string()),
        cites(case).join(", "),
    );
}

/// Each failure, with the text of its requirements and its log.
fn failures(page: &mut String, report: &Report) {
    let texts: BTreeMap<_, _> = (report.coverage.iter())
        .map(|one| (one.requirement.to_string(), one.requirement.text.clone()))
        .collect();
    for Tried { case, outcome } in report.bad() {
        let _ = writeln!(
            page,
            "<h2 class=\"fail\">{} {}</h2>\n<p>{}: {} {}</p>",
            escape(&case.id),
            escape(&case.name),
            outcome.verdict.word(),
            escape(&outcome.why),
            escape(outcome.closing.to_string()),
        );
        for cited in cites(case) {
            let text = texts.get(&cited).map_or("", String::as_str);
            let _ = writeln!(page, "<p class=\"soft\">{cited}: {}</p>", escape(text));
        }
        let _ = writeln!(page, "<pre>{}</pre>", escape(outcome.trace.join("\n")));
    }
}

fn coverage(page: &mut String, report: &Report) {
    page.push_str("<h2>Requirements</h2>\n<table>\n<tr><th>requirement</th><th>level</th><th>text</th><th>cases</th></tr>\n");
    for one in &report.coverage {
        let cases = match (&one.reason, one.cases.len()) {
            (Some(reason), 0) => format!("none: {}", escape(reason)),
            (None, 0) => "none".to_owned(),
            (_, 1..=4) => one.cases.join(", "),
            (_, count) => format!("{} and {} more", one.cases[..3].join(", "), count - 3),
        };
        let _ = writeln!(
            page,
            "<tr><td><code>{}</code></td><td>{}</td><td>{}</td><td>{cases}</td></tr>",
            one.requirement,
            one.requirement.level,
            escape(&one.requirement.text),
        );
    }
    page.push_str("</table>\n");
}
