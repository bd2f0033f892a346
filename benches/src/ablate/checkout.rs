//! Lines of code and requirements, counted in a checkout.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::task::Failure;

/// A checkout of the sources.
#[derive(Debug)]
pub(super) struct Checkout {
    root: PathBuf,
    /// Ids of requirements, such as `6.15-1`, by document.
    requirements: BTreeMap<&'static str, BTreeSet<String>>,
}

/// The documents with requirements.
const DOCUMENTS: [&str; 2] = ["PROTOCOL", "RECKONING"];

impl Checkout {
    /// Reads the requirements.
    pub(super) fn open(root: &Path) -> Result<Self, Failure> {
        let mut requirements = BTreeMap::new();
        for document in DOCUMENTS {
            let path = root.join(format!("spec/{document}.md"));
            let text = fs::read_to_string(&path).map_err(|cause| {
                format!(
                    "lines and requirements are counted in a checkout of the sources, but {} cannot be read: {cause}; \
                     name the checkout by --checkout",
                    path.display()
                )
            })?;
            requirements.insert(document, ids(&text));
        }
        Ok(Self {
            root: root.to_owned(),
            requirements,
        })
    }

    /// Requirements of a clause, such as `PROTOCOL 6.15`, or a single one, such as `PROTOCOL 6.15-1`.
    pub(super) fn requirements(&self, cited: &str) -> Result<u64, Failure> {
        let unknown = || format!("the checkout has no requirement {cited}");
        let (document, clause) = cited.split_once(' ').ok_or_else(unknown)?;
        let known = self.requirements.get(document).ok_or_else(unknown)?;
        let within = |id: &&String| {
            *id == clause
                || id
                    .strip_prefix(clause)
                    .is_some_and(|rest| rest.starts_with('-'))
        };
        match known.iter().filter(within).count() {
            0 => Err(unknown().into()),
            count => Ok(count as u64),
        }
    }

    /// Lines of code at a place: a file, a folder that ends with `/`, or `FILE#ITEM, ITEM` for items of a file, such as
    /// `src/a.rs#fn decode, struct A, impl A`. Tests, comments and blank lines do not count.
    pub(super) fn lines(&self, place: &str) -> Result<u64, Failure> {
        let (file, items) = match place.split_once('#') {
            Some((file, items)) => (file, Some(items)),
            None => (place, None),
        };
        let path = self.root.join(file);
        if file.ends_with('/') {
            return lines_below(&path);
        }
        let text = read(&path)?;
        let code = without_tests(&text);
        let Some(items) = items else {
            return Ok(code_lines(code.lines()));
        };
        let lines = |item: &str| {
            let lines = item_lines(code, item);
            Ok(lines.ok_or_else(|| format!("the checkout has no {file}#{item}"))?)
        };
        items.split(", ").map(lines).sum()
    }
}

fn read(path: &Path) -> Result<String, Failure> {
    let text = fs::read_to_string(path);
    Ok(text.map_err(|cause| format!("cannot read {}: {cause}", path.display()))?)
}

fn lines_below(folder: &Path) -> Result<u64, Failure> {
    let wrong = |cause: std::io::Error| format!("cannot read {}: {cause}", folder.display());
    let mut lines = 0;
    for entry in fs::read_dir(folder).map_err(wrong)? {
        let path = entry.map_err(wrong)?.path();
        if path.is_dir() {
            lines += lines_below(&path)?;
        } else if path.extension().is_some_and(|name| name == "rs") {
            lines += code_lines(without_tests(&read(&path)?).lines());
        }
    }
    Ok(lines)
}

/// Every bracketed id, such as `[6.15-1]`.
fn ids(text: &str) -> BTreeSet<String> {
    let inside = text.split('[').skip(1);
    let inside = inside.filter_map(|after| Some(after.split_once(']')?.0));
    let is_id = |text: &&str| {
        let parts = text.split_once('-').map(|(clause, number)| {
            let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
            clause.contains('.') && clause.split('.').all(digits) && digits(number)
        });
        parts == Some(true)
    };
    inside.filter(is_id).map(str::to_owned).collect()
}

/// The text before the module of unit tests.
fn without_tests(text: &str) -> &str {
    text.split_once("\n#[cfg(test)]\n")
        .map_or(text, |(code, _)| code)
}

fn code_lines<'a>(lines: impl Iterator<Item = &'a str>) -> u64 {
    let is_code = |line: &&str| {
        let line = line.trim_start();
        !line.is_empty() && !line.starts_with("//")
    };
    lines.filter(is_code).count() as u64
}

/// Lines of an item, from its first line to the brace or semicolon that ends it.
fn item_lines(code: &str, item: &str) -> Option<u64> {
    let opens = |line: &&str| {
        let is_code = !line.trim_start().starts_with("//");
        let follows = line.split_once(item).map(|(_, rest)| rest.chars().next());
        let ends = follows.map(|next| next.is_none_or(|c| !(c.is_alphanumeric() || c == '_')));
        is_code && ends == Some(true)
    };
    let from = code.lines().position(|line| opens(&line))?;
    let mut lines = code.lines().skip(from);
    let first = lines.clone().next()?;
    if first.ends_with(';') || first.ends_with('}') {
        return Some(1);
    }
    let indent = first.len() - first.trim_start().len();
    let closes = |line: &str| {
        let ends = ["}", "]", ")"]
            .iter()
            .any(|close| line.trim_start().starts_with(close));
        let finished = line.ends_with('}') || line.ends_with(';');
        line.len() - line.trim_start().len() == indent && ends && finished
    };
    let mut all = Vec::new();
    for line in lines.by_ref() {
        all.push(line);
        if all.len() > 1 && closes(line) {
            return Some(code_lines(all.into_iter()));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    const CODE: &str = "\
//! A file.

/// The fn decode_all is not this one.
fn decode(
    text: &str,
) -> u32 {
    // The reason.
    if text.is_empty() {
        1
    } else {
        2
    }
}

const STEPS: [u32; 2] = [
    1, 2,
];
const ONE: u32 = 1;

#[cfg(test)]
mod tests {
    fn decode() {}
}
";

    #[test]
    fn an_item_counts_from_its_first_line_to_its_end() {
        let code = without_tests(CODE);
        for (item, lines) in [
            ("fn decode", Some(9)),
            ("const STEPS", Some(3)),
            ("const ONE", Some(1)),
            ("fn decode_all", None),
            ("mod tests", None),
        ] {
            assert_eq!(item_lines(code, item), lines, "{item}");
        }
        assert_eq!(code_lines(code.lines()), 13);
    }

    #[test]
    fn ids_are_found_in_brackets_only() {
        let found = ids("[6.15-1] One (6.15-2). [6.2-10] Two [a-1] and [2.5].");
        assert_eq!(found.into_iter().collect::<Vec<_>>(), ["6.15-1", "6.2-10"]);
    }

    #[test]
    fn a_clause_counts_its_own_requirements_only() {
        let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        let checkout = Checkout::open(root).unwrap();
        let count = |cited: &str| checkout.requirements(cited).ok();
        assert_eq!(count("PROTOCOL 6.1-1"), Some(1));
        let clause = count("PROTOCOL 6.1").unwrap();
        assert!(count("PROTOCOL 6.15").unwrap() > clause && clause > 1);
        assert_eq!(count(&format!("PROTOCOL 6.{}", 99)), None);
        assert_eq!(count("APP 1.1"), None);
    }

    #[test]
    fn a_folder_without_the_documents_is_no_checkout() {
        let error = Checkout::open(&std::env::temp_dir()).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("--checkout") && message.contains("PROTOCOL.md"));
    }
}
