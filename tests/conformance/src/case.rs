//! A conformance case: one promise of one side, and how it is tested.
//!
//! The parent module describes how a case is written.

use std::fmt;

use rhumb_netsim::Carrier;

use super::feature::Feature;
use super::outcome::CaseResult;
use super::role::Role;
use super::schedule::{Profile, Schedule};
use super::trial::Trial;
use crate::requirements::Document;

/// A case as a table row: number in its group, promise, cited requirements, test function.
pub(super) type CaseRow = (
    u32,
    &'static str,
    &'static str,
    fn(&mut Trial<'_>) -> CaseResult,
);

type CaseFn = Box<dyn Fn(&mut Trial<'_>) -> CaseResult + Send + Sync>;

/// One conformance case.
pub struct Case {
    /// Level, group and number or key, separated by dots.
    pub id: String,
    /// The promise.
    pub name: String,
    /// The implementation under test.
    pub side: Role,
    /// The requirements under test.
    pub cites: Vec<(Document, String)>,
    /// Features that the peer must have.
    pub needs: Vec<Feature>,
    /// The profile that selects it.
    pub profile: Profile,
    /// When it runs relative to the others.
    pub turn: Schedule,
    /// The one transport that it runs over, if it needs that one.
    pub only_over: Option<Carrier>,
    played: Option<CaseFn>,
}

impl Case {
    /// A case of a server.
    #[must_use]
    pub fn server(id: &str, name: &str) -> Self {
        Self::of(Role::Server, id, name)
    }

    /// A case of a server with lockstep scenes, and the requirements that it shows.
    pub(crate) fn lockstep_server(id: &str, name: &str, cites: &str) -> Self {
        Self::server(id, name)
            .cites(cites)
            .needs(&[Feature::Lockstep])
    }

    /// A case of a client.
    #[must_use]
    pub fn client(id: &str, name: &str) -> Self {
        Self::of(Role::Client, id, name)
    }

    /// A case of a decoder.
    #[must_use]
    pub fn decoder(id: &str, name: &str) -> Self {
        Self::of(Role::Decoder, id, name)
    }

    /// A case of a client with a server.
    #[must_use]
    pub fn pair(id: &str, name: &str) -> Self {
        Self::of(Role::Pair, id, name)
    }

    fn of(side: Role, id: &str, name: &str) -> Self {
        Self {
            id: id.to_owned(),
            name: name.to_owned(),
            side,
            cites: Vec::new(),
            needs: Vec::new(),
            profile: Profile::Core,
            turn: Schedule::Any,
            only_over: None,
            played: None,
        }
    }

    /// One member of a family that is made from data. The last part of the id is a hash of `bytes`, so that new
    /// members do not rename the others.
    #[must_use]
    pub fn keyed(mut self, bytes: &[u8]) -> Self {
        self.id = format!("{}.{}", self.id, key(bytes));
        self
    }

    /// Adds the requirements under test, written as `PROTOCOL 3.1-1, 3.1-4; RECKONING 2.1-1`.
    ///
    /// # Panics
    ///
    /// When no document has such a name: the caller is a case of this suite.
    #[must_use]
    pub fn cites(mut self, text: &str) -> Self {
        for part in text.split("; ") {
            let (name, ids) = part
                .split_once(' ')
                .expect("a document and its requirements");
            let document = Document::ALL.into_iter().find(|one| one.name() == name);
            let document = document.expect("a document of the specification");
            let ids = ids.split(", ").map(|id| (document, id.to_owned()));
            self.cites.extend(ids);
        }
        self
    }

    /// Adds optional features that the peer must have.
    #[must_use]
    pub fn needs(mut self, features: &[Feature]) -> Self {
        self.needs.extend_from_slice(features);
        self
    }

    /// Limits the case to one carrier.
    #[must_use]
    pub fn only_over(mut self, carrier: Carrier) -> Self {
        self.only_over = Some(carrier);
        self
    }

    /// Marks a case that waits long.
    #[must_use]
    pub fn slow(mut self) -> Self {
        self.turn = Schedule::Slow;
        self
    }

    /// Marks a case that would disturb others.
    #[must_use]
    pub fn alone(mut self) -> Self {
        self.turn = Schedule::Alone;
        self
    }

    /// Limits the case to servers of the same physics engine.
    #[must_use]
    pub fn bit_exact(mut self) -> Self {
        self.profile = Profile::BitExact;
        self
    }

    /// Sets the test function.
    #[must_use]
    pub fn play(
        mut self,
        play: impl Fn(&mut Trial<'_>) -> CaseResult + Send + Sync + 'static,
    ) -> Self {
        self.played = Some(Box::new(play));
        self
    }

    /// Runs the test function.
    ///
    /// # Panics
    ///
    /// When the case has no test function.
    pub fn run(&self, trial: &mut Trial<'_>) -> CaseResult {
        let played = self.played.as_ref().expect("a case has a test function");
        played(trial)
    }

    /// True if a pattern selects this case: a prefix of the id up to a dot, or words of the name; `*` matches any
    /// text.
    #[must_use]
    pub fn is_selected_by(&self, pattern: &str) -> bool {
        let below = self.id.strip_prefix(pattern);
        below.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            || matches(pattern, &self.id)
            || matches(&format!("*{pattern}*"), &self.name)
    }
}

/// True if a text matches a pattern, in which `*` stands for any text.
fn matches(pattern: &str, text: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == text,
        Some((start, rest)) => text.strip_prefix(start).is_some_and(|text| {
            let mut ends = (0..=text.len()).filter(|end| text.is_char_boundary(*end));
            ends.any(|end| matches(rest, &text[end..]))
        }),
    }
}

/// FNV-1a hash of 32 bits, as eight hexadecimal digits.
fn key(bytes: &[u8]) -> String {
    let hash = bytes.iter().fold(0x811c_9dc5_u32, |hash, byte| {
        (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193)
    });
    format!("{hash:08x}")
}

impl fmt::Debug for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.id, self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_selected_by_its_id_its_group_and_words_of_its_name() {
        let case = Case::server("L1.2.3", "a ping is answered by a pong");
        for pattern in ["L1", "L1.2", "L1.2.3", "L1.*", "*.3", "ping is", "pong"] {
            assert!(case.is_selected_by(pattern), "{pattern}");
        }
        for pattern in ["L1.2.", "L1.20", "L", "L2", "ping * ping"] {
            assert!(!case.is_selected_by(pattern), "{pattern}");
        }
    }

    #[test]
    fn the_id_of_a_family_member_depends_on_its_data() {
        let id = |bytes: &[u8]| Case::server("L0.4", "a vector").keyed(bytes).id;
        assert_eq!(id(&[1]), id(&[1]));
        assert_ne!(id(&[1]), id(&[2]));
        assert!(id(&[1]).starts_with("L0.4.") && id(&[1]).len() == 13);
    }
}
