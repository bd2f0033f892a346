//! How patiently, over what and for how much a run of the suite tried.
//!
//! Said with each report, in the words of the command line: so that a run can be repeated.

use std::fmt;

use clap::ValueEnum;
use rhumb_transport::LinkConfig;

use crate::conformance::case::{Feature, Profile};

/// How a run tried.
#[derive(Clone, Debug, PartialEq)]
pub struct RunSettings {
    /// Of all chance.
    pub seed: u64,
    /// Seconds that an answer may take.
    pub timeout_s: f64,
    /// What lies between the ends.
    pub link: LinkConfig,
    /// How much is wanted.
    pub profile: Profile,
    /// What the peer says that it has not.
    pub without: Vec<Feature>,
}

impl RunSettings {
    /// The word of the command line for its profile.
    #[must_use]
    pub fn profile(&self) -> String {
        word(&self.profile)
    }

    /// The words of the command line for what the peer has not.
    #[must_use]
    pub fn lacking(&self) -> Vec<String> {
        self.without.iter().map(word).collect()
    }
}

impl fmt::Display for RunSettings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "seed {}, timeout {} s", self.seed, self.timeout_s)?;
        if self.link != LinkConfig::PERFECT {
            write!(f, ", link {}", self.link)?;
        }
        if self.profile != Profile::Core {
            write!(f, ", profile {}", self.profile())?;
        }
        if !self.without.is_empty() {
            write!(f, ", without {}", self.lacking().join(" and "))?;
        }
        Ok(())
    }
}

/// The word of the command line for it.
fn word(value: &impl ValueEnum) -> String {
    let possible = value.to_possible_value();
    possible.map_or_else(String::new, |value| value.get_name().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_usual_is_not_said() {
        let usual = RunSettings {
            seed: 3,
            timeout_s: 2.0,
            link: LinkConfig::PERFECT,
            profile: Profile::Core,
            without: Vec::new(),
        };
        assert_eq!(usual.to_string(), "seed 3, timeout 2 s");
        let other = RunSettings {
            link: "loss=5%".parse().expect("config of a link"),
            profile: Profile::BitExact,
            without: vec![Feature::AuthorityGrant],
            ..usual
        };
        assert_eq!(
            other.to_string(),
            "seed 3, timeout 2 s, link loss=5%, profile bit-exact, without driving"
        );
    }
}
