//! A report as JSON, for machines.

use serde_json::{Value, json};

use super::Report;
use crate::conformance::case::Case;
use crate::conformance::coverage::Covered;
use crate::conformance::run::Tried;

/// The text of a report as JSON.
#[must_use]
pub fn json(report: &Report) -> String {
    let results: Vec<_> = report.results.iter().map(result).collect();
    let coverage: Vec<_> = report.coverage.iter().map(covered).collect();
    let report = json!({
        "format": "rhumb conformance 1",
        "subject": report.subject,
        "seed": report.seed,
        "strict": report.strict,
        "passed": report.passed(),
        "summary": report.summary(),
        "cases": results,
        "coverage": coverage,
    });
    format!("{report:#}\n")
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

/// The requirements of a case, as one cites them.
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
