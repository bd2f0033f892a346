//! All cases, and which of them are wanted.
//!
//! Invariant, held by a test: no id stands twice.

use super::case::{Case, Feature, Profile, Role};
use super::{client, decoder, pair, server};

/// Which cases are wanted.
#[derive(Clone, Debug, Default)]
pub struct Selection {
    /// Patterns; none means all.
    pub patterns: Vec<String>,
    /// How much is wanted.
    pub profile: Profile,
    /// What the peer says that it has not.
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
    /// Whether a case is wanted.
    #[must_use]
    pub fn wants(&self, case: &Case) -> bool {
        let by_pattern = |pattern: &String| case.is_meant_by(pattern);
        case.profile <= self.profile
            && (self.patterns.is_empty() || self.patterns.iter().any(by_pattern))
    }

    /// What the case needs and the peer says that it has not.
    #[must_use]
    pub fn lacks(&self, case: &Case) -> Option<Feature> {
        let lacks = |feature: &&Feature| self.without.contains(feature);
        case.needs.iter().find(lacks).copied()
    }
}

/// Numbers by their value, all else by its letters.
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
    fn no_id_stands_twice() {
        let mut ids = BTreeSet::new();
        for side in Role::ALL {
            for case in cases(side) {
                assert!(ids.insert(case.id.clone()), "{case:?}: another has its id");
            }
        }
    }

    #[test]
    fn ids_are_in_order_of_their_numbers() {
        assert!(order("L0.2.9") < order("L0.10.1"));
        assert!(order("L0.2.9") < order("L0.2.12345678"));
        assert!(order("L1.2.9") > order("L0.2.a1b2c3d4"));
    }
}
