//! The settings of a run: seed, time limit, simulated network, profile.
//!
//! Each report contains them in the words of the command line, so that a run can be repeated.

use std::fmt;

use clap::ValueEnum;
use rhumb_netsim::LinkConfig;

use crate::feature::Feature;
use crate::schedule::Profile;

/// The settings of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunSettings {
    /// Seed of all random numbers.
    pub seed: u64,
    /// Seconds that the peer has to answer.
    pub timeout_s: f64,
    /// Simulated network between suite and peer.
    pub link: LinkConfig,
    /// The profile that was run.
    pub profile: Profile,
    /// Features that the peer is declared to lack.
    pub without: Vec<Feature>,
}

impl RunSettings {
    /// The profile as on the command line.
    #[must_use]
    pub fn profile(&self) -> String {
        word(&self.profile)
    }

    /// The missing features as on the command line.
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

/// A value as on the command line.
fn word(value: &impl ValueEnum) -> String {
    let possible = value.to_possible_value();
    possible.map_or_else(String::new, |value| value.get_name().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_settings_are_not_mentioned() {
        let usual = RunSettings {
            seed: 3,
            timeout_s: 2.0,
            link: LinkConfig::PERFECT,
            profile: Profile::Core,
            without: Vec::new(),
        };
        assert_eq!(usual.to_string(), "seed 3, timeout 2 s");
        let other = RunSettings {
            link: "loss=5%".parse().expect("a valid link configuration"),
            profile: Profile::BitExact,
            without: vec![Feature::Authority],
            ..usual
        };
        assert_eq!(
            other.to_string(),
            "seed 3, timeout 2 s, link loss=5%, profile bit-exact, without authority"
        );
    }
}
