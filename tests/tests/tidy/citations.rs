//! Every clause and requirement that a file cites exists in the specification.
//!
//! A citation names a document of `spec/` and a clause, as 3.4, or a requirement, as 3.4-1.

use std::collections::BTreeSet;
use std::fs;

use rhumb_conformance::requirements::{Document, is_name, parts, unnamed};

use crate::house::{File, files, report, root};

/// The numbers of a document's headings and numbered clauses.
fn clauses(document: &str) -> BTreeSet<String> {
    let text =
        fs::read_to_string(root().join(document)).expect("reading a document of the specification");
    let numbers = text.lines().filter_map(|line| {
        let line = line.trim_start_matches('#').trim_start();
        let number = line.split_whitespace().next()?.trim_end_matches('.');
        is_number(number).then(|| number.to_owned())
    });
    numbers.collect()
}

fn is_number(text: &str) -> bool {
    text.split('.')
        .all(|part| !part.is_empty() && part.bytes().all(|byte| byte.is_ascii_digit()))
}

/// The clauses of a document that a text cites, with line numbers.
fn cited(text: &str, name: &str) -> Vec<(usize, String)> {
    let mut cited = Vec::new();
    for (number, line) in text.lines().enumerate() {
        for (place, _) in line.match_indices(name) {
            let rest = line[place + name.len()..]
                .strip_prefix(' ')
                .unwrap_or_default();
            let end = rest
                .find(|c: char| !c.is_ascii_digit() && c != '.' && c != '-')
                .unwrap_or(rest.len());
            let clause = rest[..end].trim_end_matches(['.', '-']);
            if is_number(clause) || is_name(clause) {
                cited.push((number + 1, clause.to_owned()));
            }
        }
    }
    cited
}

#[test]
fn every_cited_clause_exists() {
    let mut violations = Vec::new();
    let files = files();
    for document in Document::ALL {
        let name = document.name();
        let mut clauses = clauses(&format!("spec/{name}.md"));
        clauses.extend(document.requirements().into_iter().map(|one| one.id));
        for File { path, text } in &files {
            for (line, clause) in cited(text, name) {
                if !clauses.contains(&clause) {
                    violations.push(format!("{path}:{line}: {name} has no {clause}"));
                }
            }
        }
    }
    report("a cited clause exists", &violations);
}

#[test]
fn every_requirement_has_a_unique_name_in_its_clause() {
    let mut violations = Vec::new();
    for document in Document::ALL {
        let mut seen = BTreeSet::new();
        for requirement in document.requirements() {
            let clause = requirement.id.split('-').next().unwrap_or_default();
            // The listing of a section, its clause 0, has requirements of all its clauses.
            let is_listed = (requirement.clause.strip_suffix('0'))
                .is_some_and(|section| section.ends_with('.') && clause.starts_with(section));
            if clause != requirement.clause && !is_listed {
                violations.push(format!("{requirement} is in clause {}", requirement.clause));
            }
            if requirement.text.is_empty() {
                violations.push(format!("{requirement} is empty"));
            }
            if !seen.insert(requirement.id.clone()) {
                violations.push(format!("{requirement} occurs twice"));
            }
        }
    }
    report("a requirement has a unique name", &violations);
}

#[test]
fn every_must_should_or_may_belongs_to_a_requirement() {
    let mut violations = Vec::new();
    for document in Document::ALL {
        for part in parts(document.text()) {
            let unnamed = unnamed(&part.text);
            let words = unnamed.split(|c: char| !c.is_ascii_uppercase());
            let mut bound = words.filter(|word| ["MUST", "SHOULD", "MAY"].contains(word));
            if is_number(&part.clause) && bound.next().is_some() {
                let (name, clause) = (document.name(), &part.clause);
                violations.push(format!("{name} {clause}: {unnamed}"));
            }
        }
    }
    report("a requirement has a name", &violations);
}

#[test]
fn citations_are_found() {
    // Split, so that this file itself contains no citation.
    let name = ["PROTO", "COL"].concat();
    let text = format!("see ({name} 3.4), {name} 5.\n{name}.md, {name} x, {name} 3.4-12.");
    let found = cited(&text, &name);
    let expected = [(1, "3.4"), (1, "5"), (2, "3.4-12")];
    assert_eq!(
        found,
        expected.map(|(line, clause)| (line, clause.to_owned()))
    );
}
