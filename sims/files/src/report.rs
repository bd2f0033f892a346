//! A list of the parts of a file that a scene has not, with their places.
//!
//! Equal remarks about several elements are one entry with a count.

use std::fmt;

use crate::error::Place;

/// The treatment of a part of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
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
        self.notes.push(Note {
            place: place.clone(),
            subject,
            value,
            effect,
            why,
            count: 1,
        });
    }

    /// Adds a note about a kind of things: equal ones are counted.
    pub(crate) fn again(
        &mut self,
        place: &Place,
        subject: String,
        effect: Effect,
        why: &'static str,
    ) {
        let is_same =
            |note: &&mut Note| note.why == why && note.effect == effect && note.subject == subject;
        if let Some(note) = self.notes.iter_mut().find(is_same) {
            note.count = note.count.saturating_add(1);
            return;
        }
        let full = self.notes.len() >= NOTES_MAX;
        match self.notes.last_mut().filter(|_| full) {
            Some(last) => last.count = last.count.saturating_add(1),
            None => self.notes.push(Note {
                place: place.clone(),
                subject,
                value: String::new(),
                effect,
                why,
                count: 1,
            }),
        }
    }
}
