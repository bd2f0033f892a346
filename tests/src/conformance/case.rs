//! One promise of one side, and how it is tried.
//!
//! See the parent for how one is written.

use std::fmt;

use super::outcome::CaseResult;
use super::trial::Trial;
use crate::requirements::Document;

/// Who is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// A server.
    Server,
    /// A client.
    Client,
    /// Who reads bytes, without a wire.
    Decoder,
    /// A client with a server.
    Pair,
}

/// What a server may leave out, if it says so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Feature {
    /// Scenes that step when members say so.
    Lockstep,
    /// Scenes that step by the server's clock.
    FreeRunning,
    /// Members that move bodies themselves.
    AuthorityGrant,
    /// Streams within a budget.
    Budgets,
    /// Shapes without an inside.
    Sheets,
    /// Shapes of parts.
    Compounds,
    /// Streams that speak of each so-manyeth tick, or later.
    PublishSchedule,
}

/// Which cases are wanted beyond those that every implementation must pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Profile {
    /// What makes an implementation conformant.
    #[default]
    Core,
    /// The truth of the engine of this house, to the bit, too.
    BitExact,
}

/// How a case stands to others that run beside it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Schedule {
    /// Waits long for a clock of the peer's: begins first.
    Slow,
    /// Neither.
    Any,
    /// Would disturb others: comes when they are over.
    Alone,
}

/// A case of a group as it stands in a table: its number, its promise, what it cites, and how it is tried.
pub(super) type CaseRow = (
    u32,
    &'static str,
    &'static str,
    fn(&mut Trial<'_>) -> CaseResult,
);

type CaseFn = Box<dyn Fn(&mut Trial<'_>) -> CaseResult + Send + Sync>;

/// One case.
pub struct Case {
    /// Level, group and number or key, with dots between.
    pub id: String,
    /// The promise.
    pub name: String,
    /// Who is tried.
    pub side: Role,
    /// The requirements that it tries.
    pub cites: Vec<(Document, String)>,
    /// What must be there for it to be tried.
    pub needs: Vec<Feature>,
    /// For whom it is.
    pub profile: Profile,
    /// When it runs.
    pub turn: Schedule,
    played: Option<CaseFn>,
}

impl Case {
    /// A case of a server.
    #[must_use]
    pub fn server(id: &str, name: &str) -> Self {
        Self::of(Role::Server, id, name)
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
            played: None,
        }
    }

    /// One of a family that is made from data: the last part of its id is a key of what it is made from, so that others may
    /// come between without renaming it.
    #[must_use]
    pub fn keyed(mut self, bytes: &[u8]) -> Self {
        self.id = format!("{}.{}", self.id, key(bytes));
        self
    }

    /// Which requirements it tries, as `PROTOCOL 3.1-1, 3.1-4; RECKONING 2.1-1`.
    ///
    /// # Panics
    ///
    /// When no document has such a name: the caller is one of us.
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

    /// What the peer may leave out, and must have for this.
    #[must_use]
    pub fn needs(mut self, features: &[Feature]) -> Self {
        self.needs.extend_from_slice(features);
        self
    }

    /// That it waits long.
    #[must_use]
    pub fn slow(mut self) -> Self {
        self.turn = Schedule::Slow;
        self
    }

    /// That it would disturb others.
    #[must_use]
    pub fn alone(mut self) -> Self {
        self.turn = Schedule::Alone;
        self
    }

    /// That only servers of the same engine need pass it.
    #[must_use]
    pub fn bit_exact(mut self) -> Self {
        self.profile = Profile::BitExact;
        self
    }

    /// How it is tried.
    #[must_use]
    pub fn play(
        mut self,
        play: impl Fn(&mut Trial<'_>) -> CaseResult + Send + Sync + 'static,
    ) -> Self {
        self.played = Some(Box::new(play));
        self
    }

    /// Tries it.
    ///
    /// # Panics
    ///
    /// When nothing says how.
    pub fn run(&self, trial: &mut Trial<'_>) -> CaseResult {
        let played = self.played.as_ref().expect("a case says how it is tried");
        played(trial)
    }

    /// Whether a pattern means it: the beginning of its id up to a dot, or words of its name, `*` for anything.
    #[must_use]
    pub fn is_meant_by(&self, pattern: &str) -> bool {
        let below = self.id.strip_prefix(pattern);
        below.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
            || matches(pattern, &self.id)
            || matches(&format!("*{pattern}*"), &self.name)
    }
}

/// Whether a text is as a pattern, in which `*` stands for anything.
fn matches(pattern: &str, text: &str) -> bool {
    match pattern.split_once('*') {
        None => pattern == text,
        Some((start, rest)) => text.strip_prefix(start).is_some_and(|text| {
            let mut ends = (0..=text.len()).filter(|end| text.is_char_boundary(*end));
            ends.any(|end| matches(rest, &text[end..]))
        }),
    }
}

/// Eight hexadecimal digits: FNV-1a of 32 bits.
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

impl Role {
    /// All.
    pub const ALL: [Self; 4] = [Self::Server, Self::Client, Self::Decoder, Self::Pair];

    /// The word for it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Server => "server",
            Self::Client => "client",
            Self::Decoder => "decoder",
            Self::Pair => "pair",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_case_is_meant_by_its_id_its_group_and_words_of_its_name() {
        let case = Case::server("L1.2.3", "a ping is answered by a pong");
        for pattern in ["L1", "L1.2", "L1.2.3", "L1.*", "*.3", "ping is", "pong"] {
            assert!(case.is_meant_by(pattern), "{pattern}");
        }
        for pattern in ["L1.2.", "L1.20", "L", "L2", "ping * ping"] {
            assert!(!case.is_meant_by(pattern), "{pattern}");
        }
    }

    #[test]
    fn a_family_is_named_by_what_it_is_made_from() {
        let id = |bytes: &[u8]| Case::server("L0.4", "a vector").keyed(bytes).id;
        assert_eq!(id(&[1]), id(&[1]));
        assert_ne!(id(&[1]), id(&[2]));
        assert!(id(&[1]).starts_with("L0.4.") && id(&[1]).len() == 13);
    }
}
