//! The requirements that no case tests, with reasons.
//!
//! The reasons are in `tests/conformance/data/uncovered.json`, by document and requirement. A test holds that each
//! requirement has a case or a reason, and that every citation names an existing requirement.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;

use super::role::Role;
use super::suite;
use crate::requirements::{Document, Requirement};

/// One requirement, with the cases that test it.
#[derive(Clone, Debug)]
pub struct Covered {
    /// The requirement.
    pub requirement: Requirement,
    /// Ids of its cases.
    pub cases: Vec<String>,
    /// The reason why no case tests it, if given.
    pub reason: Option<String>,
}

/// Every requirement of the documents.
///
/// # Panics
///
/// When the table of reasons is missing or is not JSON.
#[must_use]
pub fn coverage() -> Vec<Covered> {
    let mut cases: BTreeMap<(Document, String), Vec<String>> = BTreeMap::new();
    for side in Role::ALL {
        for case in suite::cases(side) {
            for cited in &case.cites {
                cases
                    .entry(cited.clone())
                    .or_default()
                    .push(case.id.clone());
            }
        }
    }
    let mut reasons = reasons();
    let requirements = Document::ALL.into_iter().flat_map(Document::requirements);
    let covered = requirements.map(|requirement| {
        let key = (requirement.document, requirement.id.clone());
        Covered {
            cases: cases.get(&key).cloned().unwrap_or_default(),
            reason: reasons.remove(&key),
            requirement,
        }
    });
    covered.collect()
}

/// The given reasons, by requirement.
///
/// # Panics
///
/// When the table is missing or is not JSON.
#[must_use]
pub fn reasons() -> BTreeMap<(Document, String), String> {
    let text = include_str!("../data/uncovered.json");
    let table: Value = serde_json::from_str(text).expect("the table is JSON");
    let mut reasons = BTreeMap::new();
    for document in Document::ALL {
        let rows = table[document.name()].as_object().into_iter().flatten();
        for (ids, reason) in rows {
            for id in ids.split(", ") {
                let reason = reason.as_str().unwrap_or_default().to_owned();
                reasons.insert((document, id.to_owned()), reason);
            }
        }
    }
    reasons
}

/// Contradictions between requirements, cases and reasons; empty when there are none.
#[must_use]
pub fn holes() -> Vec<String> {
    let coverage = coverage();
    let known: BTreeSet<_> = coverage
        .iter()
        .map(|one| (one.requirement.document, one.requirement.id.clone()))
        .collect();
    let mut holes = Vec::new();
    for one in &coverage {
        let has_reason = one.reason.as_ref().is_some_and(|reason| !reason.is_empty());
        let name = &one.requirement;
        if one.cases.is_empty() && !has_reason {
            holes.push(format!(
                "{name} has neither a case nor a reason: {}",
                name.text
            ));
        }
        if !one.cases.is_empty() && has_reason {
            holes.push(format!(
                "{name} has a case and also a reason why it has none"
            ));
        }
    }
    for (document, id) in reasons().into_keys() {
        if !known.contains(&(document, id.clone())) {
            holes.push(format!(
                "{} {id} has a reason, but no document has it",
                document.name()
            ));
        }
    }
    for side in Role::ALL {
        for case in suite::cases(side) {
            for cited in &case.cites {
                if !known.contains(cited) {
                    holes.push(format!("{case:?} cites {} {}", cited.0.name(), cited.1));
                }
            }
            if case.cites.is_empty() {
                holes.push(format!("{case:?} cites nothing"));
            }
        }
    }
    holes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of requirements in `spec/tables`, with the suite's columns `cases` and `reason` as they are now; the others
    /// are those of `old`, and belong to `spec/reference/check_tables.py`.
    fn table(old: &str) -> String {
        let old: Value = serde_json::from_str(old).expect("the table is JSON");
        let mut rows: BTreeMap<Document, Vec<String>> = BTreeMap::new();
        for one in coverage() {
            let Requirement { document, id, .. } = &one.requirement;
            let mut row: BTreeMap<&str, Value> = BTreeMap::new();
            for column in ["mutants", "unobservable", "vectors"] {
                let kept = &old[document.name()][id.as_str()][column];
                if !kept.is_null() {
                    row.insert(column, kept.clone());
                }
            }
            if !one.cases.is_empty() {
                row.insert("cases", one.cases.join(" ").into());
            }
            if let Some(reason) = one.reason {
                row.insert("reason", reason.into());
            }
            let row = serde_json::to_string(&row).expect("a row is JSON");
            let line = format!("\"{id}\": {row}");
            rows.entry(*document).or_default().push(line);
        }
        let documents = rows.into_iter().map(|(document, lines)| {
            format!("\"{}\": {{\n{}\n}}", document.name(), lines.join(",\n"))
        });
        let documents: Vec<_> = documents.collect();
        format!("{{\n{}\n}}\n", documents.join(",\n"))
    }

    /// `UPDATE_VECTORS=1` writes it.
    #[test]
    fn the_table_of_requirements_has_the_suites_cases_and_reasons() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/spec/tables/requirements.json");
        let old = std::fs::read_to_string(file).expect("the table is in the repository");
        let now = table(&old);
        if std::env::var_os("UPDATE_VECTORS").is_some() {
            return std::fs::write(file, now).expect("writing the table");
        }
        assert!(
            now == old,
            "it differs: UPDATE_VECTORS=1 cargo test -p rhumb-conformance --lib coverage"
        );
    }
}
