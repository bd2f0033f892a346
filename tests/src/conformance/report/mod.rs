//! What came of all cases, in the forms that people and machines read.

mod config;
mod html;
mod json;
mod junit;
mod style;

use std::collections::BTreeMap;

use super::coverage::Covered;
use super::matrix::Pairing;
use super::outcome::Verdict;
use super::run::Tried;

pub use config::RunSettings;
pub use html::html;
pub use json::json;
pub use junit::junit;

/// A run of the suite.
#[derive(Debug)]
pub struct Report {
    /// Who was tried: an address or a command.
    pub subject: String,
    /// How they were tried; not sent of what was recorded before.
    pub config: Option<RunSettings>,
    /// Whether what should be counts as what must be.
    pub strict: bool,
    /// What came of each case.
    pub results: Vec<Tried>,
    /// What came of each client with each server, where some were tried.
    pub pairs: Vec<Pairing>,
    /// Each requirement, with the cases that try it.
    pub coverage: Vec<Covered>,
}

impl Report {
    /// How many cases went how.
    #[must_use]
    pub fn counts(&self) -> BTreeMap<Verdict, usize> {
        let mut counts = BTreeMap::new();
        for result in &self.results {
            *counts.entry(result.outcome.verdict).or_default() += 1;
        }
        counts
    }

    /// Cases of which something is wrong.
    pub fn bad(&self) -> impl Iterator<Item = &Tried> {
        let bad = |result: &&Tried| !result.outcome.is_good(self.strict);
        self.results.iter().filter(bad)
    }

    /// Whether the peer passed. Who says of all that it has not it passed nothing, unless that was sent beforehand.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.bad().next().is_none() && !self.is_vacuous()
    }

    /// Whether all that was tried is unsupported, and nobody had sent so.
    fn is_vacuous(&self) -> bool {
        let lacks = |result: &Tried| result.outcome.verdict == Verdict::Unsupported;
        let was_said = |config: &RunSettings| !config.without.is_empty();
        self.results.iter().all(lacks) && !self.config.as_ref().is_some_and(was_said)
    }

    /// One line: how many cases, and how they went.
    #[must_use]
    pub fn summary(&self) -> String {
        let counts = self.counts();
        let counts = counts
            .iter()
            .map(|(verdict, count)| format!("{count} {}", verdict.word()));
        let counts: Vec<_> = counts.collect();
        let closing = self
            .results
            .iter()
            .filter(|one| !one.outcome.closing.is_good());
        let vacuous = if self.is_vacuous() {
            "; nothing passed, and no --without had sent so"
        } else {
            ""
        };
        format!(
            "{} cases: {}; {} closed otherwise than they must{vacuous}",
            self.results.len(),
            counts.join(", "),
            closing.count()
        )
    }
}
