//! A report as JSON, for machines.

use serde_json::{Value, json};

use super::results::Report;
use crate::case::Case;
use crate::coverage::Covered;
use crate::matrix::Pairing;
use crate::run::Tried;

/// The report as JSON.
#[must_use]
pub fn json(report: &Report) -> String {
    let results: Vec<_> = report.results.iter().map(result).collect();
    let coverage: Vec<_> = report.coverage.iter().map(covered).collect();
    let pairs: Vec<_> = report.pairs.iter().map(pair).collect();
    let mut page = json!({
        "format": "rhumb conformance 1",
        "subject": report.subject,
        "strict": report.strict,
        "passed": report.passed(),
        "summary": report.summary(),
        "cases": results,
        "coverage": coverage,
    });
    if let Some(config) = &report.config {
        page["seed"] = Value::from(config.seed);
        page["timeout_s"] = Value::from(config.timeout_s);
        page["link"] = Value::from(config.link.to_string());
        page["profile"] = Value::from(config.profile());
        page["without"] = Value::from(config.lacking());
    }
    if !pairs.is_empty() {
        page["pairs"] = Value::from(pairs);
    }
    format!("{page:#}\n")
}

/// The result of a client with a server.
fn pair(pair: &Pairing) -> Value {
    json!({
        "server": pair.server,
        "client": pair.client,
        "tried": pair.tried,
        "passed": pair.passed,
        "unsupported": pair.unsupported,
    })
}

fn result(Tried { case, outcome }: &Tried) -> Value {
    let mut line = json!({
        "id": case.id,
        "name": case.name,
        "side": case.side.word(),
        "cites": cites(case),
        "verdict": outcome.verdict.word(),
        "milliseconds": outcome.took.as_millis() as u64,
    });
    if !outcome.why.is_empty() {
        line["why"] = Value::from(outcome.why.clone());
    }
    if !outcome.closing.word().is_empty() {
        line["closing"] = Value::from(outcome.closing.to_string());
    }
    if !outcome.trace.is_empty() {
        line["trace"] = json!(outcome.trace);
    }
    line
}

/// The requirements of a case, in citation form.
pub(super) fn cites(case: &Case) -> Vec<String> {
    let cites = case.cites.iter();
    cites
        .map(|(document, id)| format!("{} {id}", document.name()))
        .collect()
}

fn covered(one: &Covered) -> Value {
    let mut line = json!({
        "requirement": one.requirement.to_string(),
        "level": one.requirement.level.to_string(),
        "cases": one.cases,
    });
    if let Some(reason) = &one.reason {
        line["reason"] = Value::from(reason.clone());
    }
    line
}
