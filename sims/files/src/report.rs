//! Errors of reading a file, and the report of what a scene has not.
//!
//! Errors are a closed set. Each sentence names the value, the limit, and the place. A report lists the parts of a file that
//! a scene has not, with their places; equal remarks about several elements are one entry with a count.

use std::collections::BTreeMap;
use std::error::Error;
use std::fmt;

use rhumb_protocol::scene::Invalid;

use crate::files::FileError;

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Place {
    /// The file, as it was asked for.
    pub file: String,
    /// Counted from one; `None`: the file as a whole.
    pub line: Option<u32>,
}

impl Place {
    /// The file as a whole.
    #[must_use]
    pub fn of(file: &str) -> Self {
        let file = file.to_owned();
        Self { file, line: None }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.file)?;
        self.line.map_or(Ok(()), |line| write!(f, ":{line}"))
    }
}

/// A file that cannot be loaded.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadError {
    /// File and line.
    pub place: Place,
    /// The problem there.
    pub problem: Problem,
}

/// Reason why a file cannot be loaded.
#[derive(Clone, Debug, PartialEq)]
pub enum Problem {
    /// The file cannot be read.
    File(FileError),
    /// Its text is not well formed; the parser's sentence.
    Syntax(String),
    /// A field that is not what it has to be.
    WrongField {
        /// The field and the body or joint that has it.
        name: String,
        /// The parser's sentence, in words of the format.
        cause: String,
    },
    /// No reader knows such a file: its first element, or its ending.
    UnknownFormat(String),
    /// An element lacks an attribute or a part.
    Missing {
        /// The element.
        element: String,
        /// The part that it lacks.
        part: &'static str,
    },
    /// A text is not a number, or not a finite one of at most 1e20.
    NotANumber {
        /// The attribute.
        attribute: String,
        /// Its text.
        text: String,
    },
    /// An attribute has another count of numbers.
    WrongCount {
        /// The attribute.
        attribute: String,
        /// The number of its values.
        found: usize,
        /// The numbers that are allowed.
        expected: &'static str,
    },
    /// A word that stands for nothing here.
    UnknownWord {
        /// The attribute.
        attribute: String,
        /// Its text.
        text: String,
    },
    /// A name that nothing has.
    UnknownName {
        /// The kind of thing that it should name.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A name that two of a kind have.
    Twice {
        /// Their kind.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// A link that hangs on itself.
    Cycle(String),
    /// A link that two joints hold.
    TwoParents(String),
    /// A link tree with several roots, or without one.
    Roots(usize),
    /// More of something than is read.
    TooMany {
        /// The things that are counted.
        what: &'static str,
        /// Their number, as far as they were counted.
        found: usize,
        /// The most that there may be.
        most: usize,
    },
    /// A file that includes itself.
    IncludeLoop(String),
    /// A mesh file that is not a mesh; the parser's sentence.
    Mesh(String),
    /// A part that this version does not read.
    Unsupported(&'static str),
    /// A body, shape or joint that no scene accepts.
    Refused {
        /// Its name.
        name: String,
        /// The rule.
        invalid: Box<Invalid>,
    },
    /// A dynamic body whose shape has another centre of mass than its origin.
    OffCentre {
        /// The body's name.
        name: String,
        /// The centre, metres in the body's axes.
        centre: [f32; 3],
    },
    /// A number that makes no sense for the named thing.
    Senseless {
        /// The thing.
        name: String,
        /// The rule that it breaks.
        rule: &'static str,
    },
}

impl Problem {
    /// Compares a number of things with the most that are read.
    pub(crate) const fn bound(what: &'static str, found: usize, most: usize) -> Result<(), Self> {
        match found > most {
            true => Err(Self::TooMany { what, found, most }),
            false => Ok(()),
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(error) => error.fmt(f),
            Self::Syntax(cause) => write!(f, "the text is not well formed: {cause}"),
            Self::UnknownFormat(what) => write!(
                f,
                "{what} is no file that is read here: URDF (robot), MJCF (mujoco), glTF 2.0 and JSON scenes are"
            ),
            Self::Missing { element, part } => write!(f, "{element} has no {part}"),
            Self::NotANumber { attribute, text } => write!(
                f,
                "{attribute} is \"{text}\", and must be a number between -1e20 and 1e20"
            ),
            Self::WrongCount {
                attribute,
                found,
                expected,
            } => write!(
                f,
                "{attribute} has {found} numbers, and must have {expected}"
            ),
            Self::UnknownWord { attribute, text } => {
                write!(f, "{attribute} is \"{text}\", which stands for nothing")
            }
            Self::UnknownName { what, name } => write!(f, "there is no {what} \"{name}\""),
            Self::Twice { what, name } => write!(f, "two have the name of {what} \"{name}\""),
            Self::Cycle(name) => write!(f, "link \"{name}\" hangs on itself"),
            Self::TwoParents(name) => write!(f, "link \"{name}\" hangs on two joints"),
            Self::Roots(count) => {
                write!(
                    f,
                    "{count} links hang on no joint, and it must be one: the root"
                )
            }
            Self::TooMany { what, found, most } => {
                write!(
                    f,
                    "the number of {what} is {found} or more, and at most {most} are read"
                )
            }
            Self::IncludeLoop(file) => write!(f, "{file} includes itself"),
            Self::Mesh(cause) => write!(f, "the mesh cannot be read: {cause}"),
            Self::Unsupported(what) => write!(f, "{what} is not read by this version"),
            Self::WrongField { name, cause } => write!(f, "{name}: {cause}"),
            Self::Refused { name, invalid } => write!(f, "{name}: {invalid}"),
            Self::OffCentre { name, centre } => write!(
                f,
                "{name}: the centre of mass of its shape must be the origin, and is at {centre:?} m: subtract this from the \
                 points of a hull and from the positions of a compound's parts, and add it, turned by the body's rotation, \
                 to the body's position; or give the body mass and moments of its own"
            ),
            Self::Senseless { name, rule } => write!(f, "{name}: {rule}"),
        }
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.problem)
    }
}

impl Error for LoadError {}

/// The treatment of a part of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Effect {
    /// It is not in the scene.
    Left,
    /// It is in the scene with another value.
    Changed,
    /// It is in the scene by something near to it.
    Approximated,
}

impl fmt::Display for Effect {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Left => "left out",
            Self::Changed => "changed",
            Self::Approximated => "approximated",
        })
    }
}

/// A part of a file that is not in the scene as it stands there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// The place of the first one.
    pub place: Place,
    /// Element and name, such as `joint "knee" mimic`.
    pub subject: String,
    /// Its value in the file, and where it helps the one in the scene.
    pub value: String,
    /// Its treatment.
    pub effect: Effect,
    /// The reason.
    pub why: &'static str,
    /// Number of elements of which this is true.
    pub count: u32,
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} {}", self.place, self.subject, self.effect)?;
        if !self.value.is_empty() {
            write!(f, " ({})", self.value)?;
        }
        if self.count > 1 {
            write!(f, " and {} more", self.count - 1)?;
        }
        write!(f, ": {}", self.why)
    }
}

/// Everything that a file says and the scene has not.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Report {
    notes: Vec<Note>,
    /// The first note of each subject, treatment and reason.
    kinds: BTreeMap<(String, Effect, &'static str), usize>,
}

/// Notes that are kept apart; further ones only raise counts of their kind.
const NOTES_MAX: usize = 4_096;

impl Report {
    /// All notes, in the order in which they were found.
    #[must_use]
    pub fn notes(&self) -> &[Note] {
        &self.notes
    }

    /// True if the scene has everything that the file says.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.notes.is_empty()
    }

    /// Adds a note about one named thing.
    pub(crate) fn add(
        &mut self,
        place: &Place,
        subject: String,
        value: String,
        effect: Effect,
        why: &'static str,
    ) {
        if self.notes.len() >= NOTES_MAX {
            return self.again(place, subject, effect, why);
        }
        self.push(Note {
            place: place.clone(),
            subject,
            value,
            effect,
            why,
            count: 1,
        });
    }

    fn push(&mut self, note: Note) {
        let kind = (note.subject.clone(), note.effect, note.why);
        self.kinds.entry(kind).or_insert(self.notes.len());
        self.notes.push(note);
    }

    /// Adds a note about a kind of things: equal ones are counted.
    pub(crate) fn again(
        &mut self,
        place: &Place,
        subject: String,
        effect: Effect,
        why: &'static str,
    ) {
        let kind = (subject, effect, why);
        let known = self.kinds.get(&kind).copied();
        let last = NOTES_MAX - 1;
        let full = (self.notes.len() > last).then_some(last);
        if let Some(note) = known.or(full).and_then(|at| self.notes.get_mut(at)) {
            note.count = note.count.saturating_add(1);
            return;
        }
        self.push(Note {
            place: place.clone(),
            subject: kind.0,
            value: String::new(),
            effect,
            why,
            count: 1,
        });
    }
}
