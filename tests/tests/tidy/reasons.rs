//! Every close code stands in the specification and in the book.

use std::fs;

use crate::house::{report, root};

/// The file that defines the close codes of the session and of the transport.
const SOURCE: &str = "protocol/src/session/mod.rs";

/// The documents with a table of all of them.
const TABLES: [&str; 2] = ["spec/PROTOCOL.md", "docs/book/src/operating/codes.md"];

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).expect("reading the repository")
}

/// Name and number of each constant of a source.
fn codes(source: &str) -> Vec<(String, u32)> {
    let lines = source.lines().filter_map(|line| {
        let (name, value) = line
            .trim()
            .strip_prefix("pub const ")?
            .split_once(": Self = Self(")?;
        let value = value.strip_suffix(");")?;
        let number = match value.strip_prefix("0x") {
            Some(digits) => u32::from_str_radix(digits, 16),
            None => value.parse(),
        };
        Some((name.to_owned(), number.ok()?))
    });
    lines.collect()
}

/// True if a row of a table, or a line of a listing, has this number and this name.
fn has_row(document: &str, name: &str, number: u32) -> bool {
    document.lines().any(|line| {
        let mut cells = line.split('|').skip(1).map(str::trim);
        let code = cells.next().and_then(|cell| cell.split(' ').next());
        let is_row = code == Some(number.to_string().as_str()) && cells.next() == Some(name);
        let listed = line.strip_prefix("    ").map(str::split_whitespace);
        is_row || listed.is_some_and(|words| words.take(2).eq([&number.to_string(), name]))
    })
}

#[test]
fn every_close_code_stands_in_the_specification_and_in_the_book() {
    let codes = codes(&read(SOURCE));
    assert!(codes.len() >= 19, "the codes are found");
    let mut violations = Vec::new();
    for path in TABLES {
        let document = read(path);
        let missing = codes
            .iter()
            .filter(|(name, number)| !has_row(&document, name, *number));
        violations.extend(missing.map(|(name, number)| format!("{path}: {number} {name}")));
    }
    report("a close code stands in the tables", &violations);
}
