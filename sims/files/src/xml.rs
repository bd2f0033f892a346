//! An XML file as elements with places, and numbers of attributes.
//!
//! Knows no format. Depth, elements and bytes are bounded; documents with a type definition are refused.

use std::rc::Rc;
use std::str::FromStr;

use glam::DVec3;
use roxmltree::{Document, Node, ParsingOptions};

use crate::files::Files;
use crate::report::{Effect, LoadError, Place, Problem, Report};

/// Bytes of a file of elements.
pub(crate) const XML_BYTES_MAX: usize = 32 << 20;
/// Nodes of a file.
const NODES_MAX: u32 = 2_000_000;
/// Elements inside each other.
const DEPTH_MAX: usize = 200;
/// Attributes of an element, each of which the parser compares with all others.
const ATTRIBUTES_MAX: usize = 1_000;
/// Namespaces of a file, which the parser copies into each element that has one.
const NAMESPACES_MAX: usize = 1_000;
/// Numbers beyond this are no lengths, masses or angles.
const NUMBER_MAX: f64 = 1e20;

/// An element with its attributes and the elements inside.
#[derive(Clone, Debug)]
pub(crate) struct Element {
    pub(crate) name: String,
    pub(crate) attributes: Vec<(String, String)>,
    pub(crate) children: Vec<Element>,
    file: Rc<str>,
    line: u32,
}

/// Reads a file as a tree; returns its bytes too.
pub(crate) fn read(files: &dyn Files, path: &str) -> Result<(Element, usize), LoadError> {
    let bytes = files.read(path, XML_BYTES_MAX).map_err(|error| LoadError {
        place: Place::of(path),
        problem: Problem::File(error),
    })?;
    let root = parse(path, &String::from_utf8_lossy(&bytes))?;
    Ok((root, bytes.len()))
}

/// Reads a text as a tree.
pub(crate) fn parse(path: &str, text: &str) -> Result<Element, LoadError> {
    let options = ParsingOptions {
        nodes_limit: NODES_MAX,
        ..ParsingOptions::default()
    };
    // Some files begin with empty lines, which no declaration may follow.
    let whole = text.trim_start_matches('\u{feff}');
    let text = whole.trim_start();
    let before = whole[..whole.len() - text.len()].matches('\n').count();
    check_attributes(text).map_err(|(problem, at)| LoadError {
        place: Place {
            file: path.to_owned(),
            line: Some((before + 1 + text[..at].matches('\n').count()) as u32),
        },
        problem,
    })?;
    let document = Document::parse_with_options(text, options).map_err(|error| LoadError {
        place: Place {
            file: path.to_owned(),
            line: Some(error.pos().row + before as u32),
        },
        problem: Problem::Syntax(error.to_string()),
    })?;
    let mut lines = vec![0];
    lines.extend(text.match_indices('\n').map(|(at, _)| at + 1));
    let tree = Tree {
        file: path.into(),
        lines,
        before,
    };
    tree.element(document.root_element(), 0)
}

/// Bounds attributes and namespaces before the parser sees them; else a problem, and the byte where it is.
fn check_attributes(text: &str) -> Result<(), (Problem, usize)> {
    let spaces = text.match_indices("xmlns").nth(NAMESPACES_MAX);
    if let Some((at, _)) = spaces {
        let what = "namespaces";
        let (found, most) = (NAMESPACES_MAX + 1, NAMESPACES_MAX);
        return Err((Problem::TooMany { what, found, most }, at));
    }
    let mut at = 0;
    while let Some(start) = text[at..].find('<').map(|start| at + start) {
        let inside = &text[start..];
        let skipped = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        let skipped = skipped.iter().find(|(first, _)| inside.starts_with(first));
        at = match skipped {
            Some((first, last)) => {
                let end = inside[first.len()..].find(last);
                end.map_or(text.len(), |end| start + first.len() + end)
            }
            None => start + tag(inside).map_err(|problem| (problem, start))?,
        };
        // The last byte of what was skipped is none that begins another one.
        at = text.len().min(at + 1);
    }
    Ok(())
}

/// The byte of a tag's end.
fn tag(inside: &str) -> Result<usize, Problem> {
    let (mut quote, mut count) = (None, 0);
    for (at, byte) in inside.bytes().enumerate() {
        match (quote, byte) {
            (None, b'>') => return Ok(at),
            (None, b'"' | b'\'') => {
                quote = Some(byte);
                count += 1;
                Problem::bound("attributes of an element", count, ATTRIBUTES_MAX)?;
            }
            (Some(own), byte) if own == byte => quote = None,
            _ => {}
        }
    }
    Ok(inside.len())
}

/// A file while its tree is built: where its lines begin.
struct Tree {
    file: Rc<str>,
    lines: Vec<usize>,
    /// Empty lines before the text.
    before: usize,
}

impl Tree {
    fn element(&self, node: Node<'_, '_>, depth: usize) -> Result<Element, LoadError> {
        let line = self
            .lines
            .partition_point(|start| *start <= node.range().start);
        let mut element = Element {
            name: node.tag_name().name().to_owned(),
            attributes: Vec::new(),
            children: Vec::new(),
            file: self.file.clone(),
            line: (line + self.before) as u32,
        };
        if depth >= DEPTH_MAX {
            return Err(element.wrong(Problem::TooMany {
                what: "elements inside each other",
                found: depth + 1,
                most: DEPTH_MAX,
            }));
        }
        let attributes = node.attributes();
        element.attributes =
            (attributes.map(|one| (one.name().to_owned(), one.value().to_owned()))).collect();
        for child in node.children().filter(Node::is_element) {
            element.children.push(self.element(child, depth + 1)?);
        }
        Ok(element)
    }
}

impl Element {
    /// Its file and line.
    pub(crate) fn place(&self) -> Place {
        Place {
            file: self.file.to_string(),
            line: Some(self.line),
        }
    }

    /// An error at this element.
    pub(crate) fn wrong(&self, problem: Problem) -> LoadError {
        let place = self.place();
        LoadError { place, problem }
    }

    /// The element and its name, as notes and errors say it.
    pub(crate) fn title(&self) -> String {
        let name = self.text("name").or_else(|| self.text("joint"));
        match name {
            Some(name) => format!("{} \"{name}\"", self.name),
            None => self.name.clone(),
        }
    }

    /// The element with other ones inside.
    pub(crate) fn with(&self, children: Vec<Self>) -> Self {
        Self {
            name: self.name.clone(),
            attributes: self.attributes.clone(),
            children,
            file: self.file.clone(),
            line: self.line,
        }
    }

    /// An element that stands in no file, for what a place needs.
    pub(crate) fn named(name: &str, place: &Place) -> Self {
        Self {
            name: name.to_owned(),
            attributes: vec![("name".to_owned(), name.to_owned())],
            children: Vec::new(),
            file: place.file.as_str().into(),
            line: place.line.unwrap_or(1),
        }
    }

    /// The element with another value of its attribute `name`, if it has one.
    pub(crate) fn named_by(mut self, change: impl Fn(&str) -> String) -> Self {
        for (name, value) in &mut self.attributes {
            if name == "name" {
                *value = change(value);
            }
        }
        self
    }

    /// The element under another name.
    pub(crate) fn renamed(&self, name: &str) -> Self {
        let name = name.to_owned();
        Self {
            name,
            ..self.with(Vec::new())
        }
    }

    /// Bytes of its attributes.
    pub(crate) fn attribute_bytes(&self) -> usize {
        let each = self.attributes.iter();
        each.map(|(name, value)| name.len() + value.len()).sum()
    }

    /// The first child of a name.
    pub(crate) fn child(&self, name: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.name == name)
    }

    /// All children of a name.
    pub(crate) fn each<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// The text of an attribute.
    pub(crate) fn text(&self, attribute: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|(name, _)| name == attribute);
        found.map(|(_, text)| text.as_str())
    }

    /// The text of an attribute that must be there.
    pub(crate) fn needs(&self, attribute: &'static str) -> Result<&str, LoadError> {
        self.text(attribute).ok_or_else(|| {
            self.wrong(Problem::Missing {
                element: self.title(),
                part: attribute,
            })
        })
    }

    /// A child that must be there.
    pub(crate) fn needs_child(&self, name: &'static str) -> Result<&Self, LoadError> {
        self.child(name).ok_or_else(|| {
            self.wrong(Problem::Missing {
                element: self.title(),
                part: name,
            })
        })
    }

    /// Notes attributes that no reader knows, as left out.
    pub(crate) fn note_unread(&self, known: &[&[&str]], why: &'static str, report: &mut Report) {
        for (name, _) in &self.attributes {
            if !known.iter().any(|names| names.contains(&name.as_str())) {
                let subject = format!("{} {name}", self.name);
                report.again(&self.place(), subject, Effect::Left, why);
            }
        }
    }

    /// All numbers of an attribute; `None` where it is not given.
    pub(crate) fn numbers(&self, attribute: &str) -> Result<Option<Vec<f64>>, LoadError> {
        let Some(text) = self.text(attribute) else {
            return Ok(None);
        };
        let number = |word: &str| {
            let number = f64::from_str(word).ok();
            let sound = number.filter(|number| number.abs() <= NUMBER_MAX);
            sound.ok_or_else(|| {
                self.wrong(Problem::NotANumber {
                    attribute: format!("{} of {}", attribute, self.title()),
                    text: word.chars().take(40).collect(),
                })
            })
        };
        let words = text.split([' ', '\t', '\n', '\r', ',']);
        let numbers: Result<_, _> = words.filter(|word| !word.is_empty()).map(number).collect();
        numbers.map(Some)
    }

    /// A single number.
    pub(crate) fn number(&self, attribute: &str) -> Result<Option<f64>, LoadError> {
        let array = self.array::<1>(attribute, "1")?;
        Ok(array.map(|[number]| number))
    }

    /// A number that must be there.
    pub(crate) fn needs_number(&self, attribute: &'static str) -> Result<f64, LoadError> {
        self.needs(attribute)?;
        Ok(self.number(attribute)?.unwrap_or_default())
    }

    /// So many numbers.
    pub(crate) fn array<const N: usize>(
        &self,
        attribute: &str,
        expected: &'static str,
    ) -> Result<Option<[f64; N]>, LoadError> {
        let Some(numbers) = self.numbers(attribute)? else {
            return Ok(None);
        };
        let found = numbers.len();
        let array = <[f64; N]>::try_from(numbers);
        array
            .map(Some)
            .map_err(|_| self.count(attribute, found, expected))
    }

    /// Three numbers.
    pub(crate) fn vector(&self, attribute: &str) -> Result<Option<DVec3>, LoadError> {
        let array = self.array::<3>(attribute, "3")?;
        Ok(array.map(DVec3::from_array))
    }

    /// The error of a count of numbers.
    pub(crate) fn count(&self, attribute: &str, found: usize, expected: &'static str) -> LoadError {
        self.wrong(Problem::WrongCount {
            attribute: format!("{} of {}", attribute, self.title()),
            found,
            expected,
        })
    }

    /// The error of a word that stands for nothing.
    pub(crate) fn unknown_word(&self, attribute: &str) -> LoadError {
        let text = self.text(attribute).unwrap_or_default();
        self.wrong(Problem::UnknownWord {
            attribute: format!("{} of {}", attribute, self.title()),
            text: text.chars().take(40).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_know_their_lines_and_numbers_their_attributes() {
        let tree = parse("a.xml", "<a>\n <b name='x' n='1 2 q'/>\n</a>").expect("it is XML");
        let b = tree.child("b").expect("it is there");
        assert_eq!(b.place().line, Some(2));
        let wrong = b.numbers("n").expect_err("q is no number");
        assert_eq!(
            wrong.to_string(),
            "a.xml:2: n of b \"x\" is \"q\", and must be a number between -1e20 and 1e20"
        );
    }

    #[test]
    fn deep_cut_and_expanding_documents_are_refused() {
        let deep = format!("{}{}", "<a>".repeat(300), "</a>".repeat(300));
        let cut = "<a><b></a>".to_owned();
        let bomb = "<!DOCTYPE a [<!ENTITY b 'x'>]><a>&b;</a>".to_owned();
        for text in [deep, cut, bomb, String::new()] {
            let error = parse("a.xml", &text).expect_err("it is not read");
            assert!(error.to_string().starts_with("a.xml"), "{error}");
        }
    }

    #[test]
    fn attributes_that_the_parser_compares_with_each_other_are_bounded() {
        let many = |count: usize| -> String {
            let each = (0..count).map(|number| format!(" a{number}='>'"));
            each.collect()
        };
        let comment = format!("<!--><x{}-->", many(2_000));
        let text = format!("<!-- ' --><![CDATA[']]>{comment}\n<b{}/>", many(1_000));
        parse("a.xml", &format!("<a>{text}</a>")).expect("they are as many as may be");
        let wrong = parse("a.xml", &format!("<a>{text}\n<b{}/></a>", many(400_000)));
        let wrong = wrong.expect_err("they are too many").to_string();
        let expected = "a.xml:3: the number of attributes of an element is 1001 or more, and at most 1000 are read";
        assert_eq!(wrong, expected);
        let spaces = "<b xmlns:x='y'/>".repeat(1_001);
        let wrong = parse("a.xml", &format!("<a>{spaces}</a>")).expect_err("they are too many");
        assert!(wrong.to_string().contains("namespaces is 1001"), "{wrong}");
    }
}
