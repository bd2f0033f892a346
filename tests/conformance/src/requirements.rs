//! The named requirements in the documents of `spec/`, with their texts.
//!
//! A requirement begins at its name in brackets, as `[2.2-1]`, and ends at the next name or at the end of its
//! paragraph, list item or table row. A name at the end of a line of a listing is that of this line and of those indented
//! below it. A requirement is a MUST unless it contains SHOULD or MAY.

use std::fmt;

/// A document of the specification.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Document {
    /// The bytes, and which side may send them when.
    Protocol,
    /// The arithmetic of motion.
    Reckoning,
}

/// The level of a requirement, in the words of RFC 2119.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// An implementation that does otherwise is not conformant.
    Must,
    /// An implementation may do otherwise with a reason.
    Should,
    /// A choice of one side that the other side must accept.
    May,
}

/// One requirement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Requirement {
    /// The document that contains it.
    pub document: Document,
    /// Its name without brackets, as `2.2-1`.
    pub id: String,
    /// The clause that contains it, as `2.2`.
    pub clause: String,
    /// Its level.
    pub level: Level,
    /// Its text, on one line.
    pub text: String,
}

impl Document {
    /// Both documents, in reading order.
    pub const ALL: [Self; 2] = [Self::Protocol, Self::Reckoning];

    /// The word by which it is cited.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Protocol => "PROTOCOL",
            Self::Reckoning => "RECKONING",
        }
    }

    /// Its text, as this build embeds it.
    #[must_use]
    pub const fn text(self) -> &'static str {
        match self {
            Self::Protocol => include_str!("../spec/PROTOCOL.md"),
            Self::Reckoning => include_str!("../spec/RECKONING.md"),
        }
    }

    /// Its requirements, in document order.
    #[must_use]
    pub fn requirements(self) -> Vec<Requirement> {
        requirements(self, self.text())
    }
}

impl fmt::Display for Level {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Must => "MUST",
            Self::Should => "SHOULD",
            Self::May => "MAY",
        })
    }
}

impl fmt::Display for Requirement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.document.name(), self.id)
    }
}

/// The requirements in a text.
#[must_use]
pub fn requirements(document: Document, text: &str) -> Vec<Requirement> {
    let mut found = Vec::new();
    for Part { clause, text } in parts(text) {
        let names = names(&text);
        for (place, (start, end)) in names.iter().enumerate() {
            let until = names.get(place + 1).map_or(text.len(), |(next, _)| *next);
            let sent = text[*end..until].trim().trim_matches('|').trim();
            found.push(Requirement {
                document,
                id: text[start + 1..end - 1].to_owned(),
                clause: clause.clone(),
                level: level(sent),
                text: sent.to_owned(),
            });
        }
    }
    found
}

/// A paragraph, list item, table row, or a named line of a listing with those indented below it, on one line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Part {
    /// The clause that contains it.
    pub clause: String,
    /// Its text.
    pub text: String,
}

/// The paragraphs, list items and table rows of a text, and the named lines of its listings, without headings, notes and
/// other code.
#[must_use]
pub fn parts(text: &str) -> Vec<Part> {
    let mut parts: Vec<Part> = Vec::new();
    let mut clause = String::new();
    let mut open = false;
    let lines: Vec<&str> = text.lines().collect();
    for (place, line) in lines.iter().copied().enumerate() {
        let goes_on = open && !line.is_empty() && !begins_a_part(line);
        open = false;
        if let Some(heading) = line.strip_prefix('#') {
            let heading = heading.trim_start_matches('#').trim_start();
            clause = heading.split(' ').next().unwrap_or_default().to_owned();
        } else if goes_on {
            let part = parts.last_mut().expect("an open part");
            part.text.push(' ');
            part.text.push_str(line.trim());
            open = true;
        } else if line.starts_with("    ") {
            let clause = clause.clone();
            parts.extend(listed(&lines[place..]).map(|text| Part { clause, text }));
        } else if !line.is_empty() {
            let (clause, text) = (clause.clone(), line.trim().to_owned());
            parts.push(Part { clause, text });
            open = !line.starts_with('|');
        }
    }
    parts.retain(|part| !part.text.starts_with("*Note"));
    parts
}

/// The first line of a listing and those indented below it, after the name at its end; none if it has no name.
fn listed(lines: &[&str]) -> Option<String> {
    let (line, below) = lines.split_first()?;
    let line = line.trim_end();
    let (start, _) = (names(line).into_iter()).find(|(_, end)| *end == line.len())?;
    let below = below
        .iter()
        .take_while(|other| other.starts_with("    ") && depth(other) > depth(line));
    let mut text = format!("{} {}", &line[start..], line[..start].trim());
    for other in below {
        let end = names(other)
            .first()
            .map_or(other.len(), |(start, _)| *start);
        text.push(' ');
        text.push_str(other[..end].trim());
    }
    Some(text)
}

/// The column at which a line of a listing begins, after its label, as `S34`.
fn depth(line: &str) -> usize {
    let rest = line.trim_start();
    let label = rest.split(' ').next().unwrap_or_default();
    let is_label = label
        .strip_prefix(['S', 'P'])
        .is_some_and(|number| number.parse::<u32>().is_ok());
    let rest = if is_label {
        rest[label.len()..].trim_start()
    } else {
        rest
    };
    line.len() - rest.len()
}

/// The text of a part before its first requirement name.
#[must_use]
pub fn unnamed(text: &str) -> &str {
    names(text)
        .first()
        .map_or(text, |(start, _)| &text[..*start])
}

fn begins_a_part(line: &str) -> bool {
    let numbered = line.split_once(". ").is_some_and(|(number, _)| {
        !number.is_empty() && number.bytes().all(|byte| byte.is_ascii_digit())
    });
    numbered
        || ["|", "#", "- ", "    "]
            .iter()
            .any(|start| line.starts_with(start))
}

/// Start and end of each requirement name, brackets included.
fn names(text: &str) -> Vec<(usize, usize)> {
    let brackets = text.match_indices('[').filter_map(|(start, _)| {
        let end = start + text[start..].find(']')? + 1;
        is_name(&text[start + 1..end - 1]).then_some((start, end))
    });
    brackets.collect()
}

/// True if a text is a clause, a hyphen and a number.
#[must_use]
pub fn is_name(text: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    text.split_once('-')
        .is_some_and(|(clause, number)| clause.split('.').all(is_number) && is_number(number))
}

fn level(text: &str) -> Level {
    let says = |word: &str| {
        let words = text.split(|c: char| !c.is_ascii_uppercase());
        words.into_iter().any(|one| one == word)
    };
    if says("MUST") {
        Level::Must
    } else if says("SHOULD") {
        Level::Should
    } else if says("MAY") {
        Level::May
    } else {
        Level::Must
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# A\n\nBefore.\n\n### 2.1 Words\n\nNothing yet. [2.1-1] It is so\nand so. [2.1-2] One MAY\n\
        ask; [2.1-4] one SHOULD.\n\n*Note.* MUST is [not] sent.\n\n    S8   a:   [2.1-6]\n    S9       \
        b MAY c [2.1-7]\n    S10  [2.1-9] d\n\n\
        | a | [2.1-3] b MUST NOT |\n| c | d [3] |\n1. [2.1-5] an item\n2. another\n";

    #[test]
    fn requirements_are_found_with_their_texts() {
        let found = requirements(Document::Protocol, TEXT);
        let found: Vec<_> = found
            .iter()
            .map(|one| (&one.id[..], one.level, &one.text[..]))
            .collect();
        let expected = [
            ("2.1-1", Level::Must, "It is so and so."),
            ("2.1-2", Level::May, "One MAY ask;"),
            ("2.1-4", Level::Should, "one SHOULD."),
            ("2.1-6", Level::May, "S8   a: S9       b MAY c"),
            ("2.1-7", Level::May, "S9       b MAY c"),
            ("2.1-3", Level::Must, "b MUST NOT"),
            ("2.1-5", Level::Must, "an item"),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn the_protocol_has_requirements() {
        let protocol = Document::Protocol.requirements();
        assert!(protocol.len() > 200, "{}", protocol.len());
        assert_eq!(protocol[0].to_string(), "PROTOCOL 1.1-1");
    }
}
