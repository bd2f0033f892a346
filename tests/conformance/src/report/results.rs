//! A run of the suite with the result of each case.

use std::collections::BTreeMap;

use super::config::RunSettings;
use crate::coverage::Covered;
use crate::matrix::Pairing;
use crate::outcome::Verdict;
use crate::run::Tried;

/// A run of the suite.
#[derive(Debug)]
pub struct Report {
    /// The peer under test: an address or a command.
    pub subject: String,
    /// The settings of the run; absent for a recorded run.
    pub config: Option<RunSettings>,
    /// True if SHOULD counts as MUST.
    pub strict: bool,
    /// The result of each case.
    pub results: Vec<Tried>,
    /// The result of each client with each server, in a matrix run.
    pub pairs: Vec<Pairing>,
    /// Each requirement, with the cases that test it.
    pub coverage: Vec<Covered>,
}

impl Report {
    /// Number of cases by verdict.
    #[must_use]
    pub fn counts(&self) -> BTreeMap<Verdict, usize> {
        let mut counts = BTreeMap::new();
        for result in &self.results {
            *counts.entry(result.outcome.verdict).or_default() += 1;
        }
        counts
    }

    /// The cases that are not good.
    pub fn bad(&self) -> impl Iterator<Item = &Tried> {
        let bad = |result: &&Tried| !result.outcome.is_good(self.strict);
        self.results.iter().filter(bad)
    }

    /// True if the peer passed. A run in which every case is unsupported passes only if `--without` declared it.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.bad().next().is_none() && !self.is_vacuous()
    }

    /// True if every case is unsupported although nothing was declared with `--without`.
    fn is_vacuous(&self) -> bool {
        let lacks = |result: &Tried| result.outcome.verdict == Verdict::Unsupported;
        let was_declared = |config: &RunSettings| !config.without.is_empty();
        self.results.iter().all(lacks) && !self.config.as_ref().is_some_and(was_declared)
    }

    /// One line: the number of cases, and their verdicts.
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
            "; nothing passed, and --without declares nothing missing"
        } else {
            ""
        };
        format!(
            "{} cases: {}; {} closed wrongly{vacuous}",
            self.results.len(),
            counts.join(", "),
            closing.count()
        )
    }
}
