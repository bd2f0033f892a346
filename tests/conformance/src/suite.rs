//! The list of all cases, and which of them are selected.
//!
//! Invariant, held by a test: ids are unique.

use super::case::Case;
use super::feature::Feature;
use super::role::Role;
use super::schedule::Profile;
use super::{client, decoder, pair, server};

/// The selection of cases.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Patterns; an empty list selects all cases.
    pub patterns: Vec<String>,
    /// The profile to run.
    pub profile: Profile,
    /// Features that the peer is declared to lack.
    pub without: Vec<Feature>,
}

/// Every case of a side, in order of id.
#[must_use]
pub fn cases(side: Role) -> Vec<Case> {
    let mut cases = match side {
        Role::Server => server::cases(),
        Role::Client => client::cases(),
        Role::Decoder => decoder::cases(),
        Role::Pair => pair::cases(),
    };
    cases.sort_by_key(|case| order(&case.id));
    cases
}

impl Selection {
    /// True if a case is selected.
    #[must_use]
    pub fn wants(&self, case: &Case) -> bool {
        let by_pattern = |pattern: &String| case.is_selected_by(pattern);
        case.profile <= self.profile
            && (self.patterns.is_empty() || self.patterns.iter().any(by_pattern))
    }

    /// The feature that the case needs and the peer lacks, if any.
    #[must_use]
    pub fn lacks(&self, case: &Case) -> Option<Feature> {
        let lacks = |feature: &&Feature| self.without.contains(feature);
        case.needs.iter().find(lacks).copied()
    }
}

/// Sort key of an id: numbers by value, everything else as text.
fn order(id: &str) -> Vec<(u64, String)> {
    let parts = id.trim_start_matches('L').split('.');
    let part = |text: &str| match text.parse() {
        Ok(number) if text.len() < 8 => (number, String::new()),
        _ => (u64::MAX, text.to_owned()),
    };
    parts.map(part).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn ids_are_unique() {
        let mut ids = BTreeSet::new();
        for side in Role::ALL {
            for case in cases(side) {
                assert!(
                    ids.insert(case.id.clone()),
                    "{case:?}: its id is not unique"
                );
            }
        }
    }

    #[test]
    fn ids_are_sorted_by_their_numbers() {
        assert!(order("L0.2.9") < order("L0.10.1"));
        assert!(order("L0.2.9") < order("L0.2.12345678"));
        assert!(order("L1.2.9") > order("L0.2.a1b2c3d4"));
    }
}
