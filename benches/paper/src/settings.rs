//! Settings that define an experiment, so that trials of two never mix.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Everything on which a trial's outcome may depend, except its number.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Settings {
    /// Name of the script.
    pub(crate) scene: String,
    /// Balls in the pit, stage by stage: consecutive multiples of the first.
    pub(crate) loads: Vec<u32>,
    /// Frames of each stage.
    pub(crate) frames_per_load: u32,
    /// Steps of each frame.
    pub(crate) steps_per_frame: u32,
    /// Frames per second of simulated time.
    pub(crate) frames_per_second: f64,
    /// Tolerance of the predicted modes, metres.
    pub(crate) tolerance_m: f64,
    /// Modes, in the order of the report.
    pub(crate) modes: Vec<String>,
    /// Seed of the first trial; each later trial has the next one.
    pub(crate) seed: u64,
    /// Cores of the caller and the servers.
    pub(crate) cores: String,
    /// Threads of an engine.
    pub(crate) threads: u32,
    /// Build profile, version and commit.
    pub(crate) build: String,
    /// Processor, cores, operating system.
    pub(crate) machine: String,
}

/// The first setting in which two experiments differ.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Difference {
    /// Name of the setting.
    pub(crate) setting: String,
    /// Value in the first experiment.
    pub(crate) one: String,
    /// Value in the second experiment.
    pub(crate) other: String,
}

impl fmt::Display for Difference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} and {}", self.setting, self.one, self.other)
    }
}

impl Settings {
    /// Seed of a trial, counted from 1.
    #[must_use]
    pub(crate) const fn seed_of(&self, trial: u32) -> u64 {
        self.seed.wrapping_add(trial as u64 - 1)
    }

    /// The first setting that differs from `other`.
    #[must_use]
    pub(crate) fn difference(&self, other: &Self) -> Option<Difference> {
        let fields = |settings: &Self| match serde_json::to_value(settings) {
            Ok(serde_json::Value::Object(fields)) => fields,
            _ => serde_json::Map::new(),
        };
        let (ours, theirs) = (fields(self), fields(other));
        let differs =
            |(name, _): &(&String, &serde_json::Value)| ours.get(*name) != theirs.get(*name);
        let (setting, one) = ours.iter().find(differs)?;
        Some(Difference {
            setting: setting.clone(),
            one: one.to_string(),
            other: theirs
                .get(setting)
                .map_or_else(String::new, ToString::to_string),
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn settings() -> Settings {
        Settings {
            scene: "ball-pit".to_owned(),
            loads: vec![500, 1_000],
            frames_per_load: 340,
            steps_per_frame: 6,
            frames_per_second: 11.33,
            tolerance_m: 0.05,
            modes: ["integrated", "naive", "rhumb", "rhumb-pipelined"]
                .map(str::to_owned)
                .into(),
            seed: 1,
            cores: "caller 0, servers 1".to_owned(),
            threads: 1,
            build: "release, 0.1.0".to_owned(),
            machine: "a machine".to_owned(),
        }
    }

    #[test]
    fn a_difference_names_its_setting() {
        let one = settings();
        assert_eq!(one.difference(&one), None);
        let other = Settings {
            loads: vec![500],
            ..settings()
        };
        let message = one.difference(&other).unwrap().to_string();
        assert_eq!(message, "loads: [500,1000] and [500]");
        let other = Settings {
            machine: "another".to_owned(),
            ..settings()
        };
        assert_eq!(one.difference(&other).unwrap().setting, "machine");
    }

    #[test]
    fn each_trial_has_its_own_seed() {
        let seeds: Vec<_> = (1..=3).map(|trial| settings().seed_of(trial)).collect();
        assert_eq!(seeds, [1, 2, 3]);
    }
}
