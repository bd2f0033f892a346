//! Documents for people: their lengths, and the paths and figures they name.
//!
//! Reads Markdown line by line. It does not judge what a sentence says.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

use crate::house::{report, root};

/// Each document with a limit, and its most words outside code blocks.
const WORDS_MAX: [(&str, usize); 3] = [
    ("README.md", 900),
    ("ARCHITECTURE.md", 2_500),
    ("docs/results/README.md", 900),
];

/// Documents whose tables of figures name their source in each row.
const SUMMARIES: [&str; 2] = ["README.md", "docs/results/README.md"];

/// Documents whose tables repeat figures of another one.
const REPEATED: [(&str, &str); 1] = [("docs/book/src/tolerance.md", "docs/results/stream.md")];

/// Folders of documents, beside the root.
const FOLDERS: [&str; 4] = ["", "docs/developing", "docs/decisions", "docs/results"];

/// Folders of the book's chapters.
const CHAPTERS: [&str; 3] = [
    "docs/book/src",
    "docs/book/src/how-to",
    "docs/book/src/operating",
];

/// The program that the README shows, which a documentation test runs.
const FIRST_PROGRAM: &str = "client/examples/first.rs";

/// The parts of a decision record, in order.
const RECORD_PARTS: [&str; 4] = ["Status: ", "## Context", "## Decision", "## Measurement"];

/// One document of the repository.
struct Document {
    /// From the root, with slashes.
    path: String,
    text: String,
}

impl Document {
    fn read(path: &str) -> Self {
        let text = fs::read_to_string(root().join(path)).expect("the document exists");
        Self {
            path: path.to_owned(),
            text,
        }
    }

    /// Numbered lines outside fenced code blocks.
    fn prose(&self) -> impl Iterator<Item = (usize, &str)> {
        let mut in_code = false;
        self.text.lines().enumerate().filter_map(move |(at, line)| {
            let is_fence = line.trim_start().starts_with("```");
            in_code ^= is_fence;
            (!in_code && !is_fence).then_some((at + 1, line))
        })
    }

    /// A path that is written relative to this document.
    fn beside(&self, path: &str) -> PathBuf {
        let folder = Path::new(&self.path).parent().unwrap_or(Path::new(""));
        root().join(folder).join(path)
    }
}

/// Names of the Markdown files of a folder, in order.
fn markdown_of(folder: &str) -> Vec<String> {
    let entries = fs::read_dir(root().join(folder)).expect("the folder exists");
    let names = entries.map(|entry| entry.expect("an entry").file_name());
    let mut names: Vec<_> = names
        .map(|name| name.to_string_lossy().into_owned())
        .filter(|name| Path::new(name).extension().is_some_and(|end| end == "md"))
        .collect();
    names.sort();
    names
}

fn documents() -> Vec<Document> {
    let of_folder = |folder: &str| {
        let join = |name: String| match folder {
            "" => name,
            _ => format!("{folder}/{name}"),
        };
        markdown_of(folder).into_iter().map(join).collect()
    };
    let paths = FOLDERS
        .into_iter()
        .chain(CHAPTERS)
        .flat_map::<Vec<String>, _>(of_folder)
        // The changelog names what was there at the time.
        .filter(|path| path != "CHANGELOG.md");
    paths.map(|path| Document::read(&path)).collect()
}

#[test]
fn documents_are_as_short_as_they_promise() {
    let mut violations = Vec::new();
    for (path, max) in WORDS_MAX {
        let document = Document::read(path);
        let words: usize = document
            .prose()
            .map(|(_, line)| line.split_whitespace().count())
            .sum();
        if words > max {
            violations.push(format!("{path}: {words} words, {max} at most"));
        }
    }
    report("a document for new_bodies is short", &violations);
}

/// The code spans of a line.
fn spans(line: &str) -> impl Iterator<Item = &str> {
    line.split('`').skip(1).step_by(2)
}

/// The fragment by which a heading is linked: lower case, hyphens for spaces, no other punctuation.
fn fragment(heading: &str) -> String {
    let kept = |c: char| (c.is_alphanumeric() || c == '-').then_some(c);
    let letters = heading.trim_start_matches('#').trim().chars();
    letters
        .filter_map(|c| if c == ' ' { Some('-') } else { kept(c) })
        .flat_map(char::to_lowercase)
        .collect()
}

#[test]
fn every_heading_that_a_link_names_exists() {
    let mut violations = Vec::new();
    for document in documents() {
        for (number, line) in document.prose() {
            let ends = line
                .split("](")
                .skip(1)
                .filter_map(|end| end.split_once(')'));
            let targets = ends.filter_map(|(target, _)| target.split_once('#'));
            for (path, wanted) in targets.filter(|(path, _)| !path.contains("://")) {
                let target = match path {
                    "" => document.text.clone(),
                    _ => fs::read_to_string(document.beside(path)).unwrap_or_default(),
                };
                let mut headings = target.lines().filter(|line| line.starts_with('#'));
                if !headings.any(|heading| fragment(heading) == wanted) {
                    violations.push(format!("{}:{number}: {path}#{wanted}", document.path));
                }
            }
        }
    }
    report("a link leads to a heading", &violations);
}

/// The targets of the links of a line, without their fragments.
fn links(line: &str) -> impl Iterator<Item = &str> {
    let ends = line.split("](").skip(1);
    ends.filter_map(|end| Some(end.split_once(')')?.0.split('#').next().unwrap_or_default()))
}

/// True if a code span names a path in this repository: its first folder is there, and is not made by a build.
fn is_path(span: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "/._-*".contains(c);
    let Some((first, _)) = span.split_once('/') else {
        return false;
    };
    let made = ["", ".", "..", "target", "results"];
    span.chars().all(is_plain) && !made.contains(&first) && root().join(first).is_dir()
}

/// True if a path is there; a star at its end stands for any ending.
fn exists(path: &str) -> bool {
    let Some(start) = path.strip_suffix('*') else {
        return root().join(path).exists();
    };
    let (folder, start) = start.rsplit_once('/').unwrap_or(("", start));
    let entries = fs::read_dir(root().join(folder)).into_iter().flatten();
    entries
        .flatten()
        .any(|entry| entry.file_name().to_string_lossy().starts_with(start))
}

#[test]
fn every_path_that_a_document_names_exists() {
    let mut violations = Vec::new();
    for document in documents() {
        for (number, line) in document.prose() {
            let missing = spans(line).filter(|span| is_path(span) && !exists(span));
            let is_dead = |link: &&str| {
                !link.is_empty() && !link.contains("://") && !document.beside(link).exists()
            };
            for path in missing.chain(links(line).filter(is_dead)) {
                violations.push(format!("{}:{number}: {path}", document.path));
            }
        }
    }
    report("a path in a document exists", &violations);
}

#[test]
fn every_chapter_is_in_the_contents_of_the_book() {
    let contents = Document::read("docs/book/src/SUMMARY.md");
    let listed: BTreeSet<_> = contents.text.lines().flat_map(links).collect();
    let chapters = CHAPTERS.into_iter().flat_map(|folder| {
        let within = folder.trim_start_matches("docs/book/src");
        let within = within.trim_start_matches('/').to_owned();
        let join = move |name: String| match within.as_str() {
            "" => name,
            within => format!("{within}/{name}"),
        };
        markdown_of(folder).into_iter().map(join)
    });
    let missing = chapters
        .filter(|name| name != "SUMMARY.md" && !listed.contains(name.as_str()))
        .collect::<Vec<_>>();
    report("SUMMARY.md lists every chapter", &missing);
}

#[test]
fn the_readme_shows_its_first_program_as_it_is() {
    let program = fs::read_to_string(root().join(FIRST_PROGRAM)).expect("reading the program");
    let begin = program.find("use ").expect("a program imports");
    let shown = format!("```rust\n{}```", &program[begin..]);
    let readme = Document::read("README.md").text;
    assert!(
        readme.contains(&shown),
        "README.md differs from {FIRST_PROGRAM}"
    );
}

#[test]
fn every_decision_has_its_parts_and_is_listed() {
    let index = Document::read("docs/decisions/README.md").text;
    let mut violations = Vec::new();
    let records = markdown_of("docs/decisions")
        .into_iter()
        .filter(|name| name != "README.md");
    for (number, name) in (1..).zip(records) {
        if !name.starts_with(&format!("{number:04}-")) {
            violations.push(format!("{name}: number {number:04} is missing"));
        }
        if !index.contains(&format!("]({name})")) {
            violations.push(format!("{name}: the list of decisions does not name it"));
        }
        let record = Document::read(&format!("docs/decisions/{name}"));
        let mut lines = record.text.lines();
        for part in RECORD_PARTS {
            if !lines.any(|line| line.starts_with(part)) {
                violations.push(format!("{name}: {part:?} is missing or in another place"));
            }
        }
    }
    report("a decision is recorded in one form", &violations);
}

/// The numbers of a text, as they are written.
fn numbers(text: &str) -> impl Iterator<Item = &str> {
    text.split(|c: char| !c.is_ascii_alphanumeric() && c != '.' && c != ',')
        .map(|word| word.trim_matches(['.', ',']))
        .filter(|word| word.starts_with(|c: char| c.is_ascii_digit()))
        .filter(|word| !word.contains(|c: char| c.is_ascii_alphabetic()))
}

#[test]
fn every_figure_of_a_summary_stands_in_its_source() {
    let mut violations = Vec::new();
    for path in SUMMARIES {
        let document = Document::read(path);
        let rows = document.prose().filter(|(_, line)| line.starts_with('|'));
        for (number, row) in rows {
            let Some((figures, source)) = row.split_once('[') else {
                continue;
            };
            let source = links(source).next().expect("a source is a link");
            let source = fs::read_to_string(document.beside(source)).unwrap_or_default();
            let known: BTreeSet<_> = numbers(&source).collect();
            for figure in numbers(figures).filter(|figure| !known.contains(figure)) {
                violations.push(format!("{path}:{number}: {figure}"));
            }
        }
    }
    for (path, source) in REPEATED {
        let (document, source) = (Document::read(path), Document::read(source));
        let known: BTreeSet<_> = numbers(&source.text).collect();
        let rows = document.prose().filter(|(_, line)| line.starts_with('|'));
        for (number, row) in rows {
            for figure in numbers(row).filter(|figure| !known.contains(figure)) {
                violations.push(format!("{path}:{number}: {figure}"));
            }
        }
    }
    report(
        "a figure is one of the page that its row names",
        &violations,
    );
}

#[test]
fn numbers_paths_and_links_are_found() {
    let found: Vec<_> = numbers("| 65.4 kbit/s, 10,000 of 2× a1 (5 %) |").collect();
    assert_eq!(found, ["65.4", "10,000", "2", "5"]);
    let line = "see `tests/tests` and [this](README.md#top), [that](https://example.org/a)";
    assert!(spans(line).any(is_path));
    assert_eq!(
        links(line).collect::<Vec<_>>(),
        ["README.md", "https://example.org/a"]
    );
    assert!(exists("server/src/engine/rapier*") && !exists("server/src/engine/none*"));
}
