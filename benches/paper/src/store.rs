//! Outcomes of trials, stored so that an experiment can be continued.
//!
//! Each file is written whole or not at all. Trials of other settings or another machine are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::{fs, io};

use rhumb_bench::output;
use serde::{Deserialize, Serialize};

use crate::settings::{PaperError, Settings};

/// An experiment's folder.
#[derive(Debug)]
pub(crate) struct Store {
    trials: PathBuf,
}

impl Store {
    /// Opens a folder for these settings; creates it if missing.
    pub(crate) fn open(out: &Path, settings: &Settings) -> Result<Self, PaperError> {
        let trials = out.join("trials");
        output::make_folder(&trials)?;
        let path = out.join("experiment.json");
        match fs::read(&path) {
            Ok(bytes) => {
                let kept: Settings = parse(&path, &bytes)?;
                if let Some(difference) = kept.difference(settings) {
                    let folder = out.to_owned();
                    return Err(PaperError::OtherExperiment { folder, difference });
                }
            }
            Err(cause) if cause.kind() == io::ErrorKind::NotFound => {
                output::write_json(&path, settings)?;
            }
            Err(cause) => return Err(PaperError::Read { path, cause }),
        }
        Ok(Self { trials })
    }

    /// The finished trials, by number.
    pub(crate) fn trials(&self) -> Result<BTreeMap<u32, ExperimentTrial>, PaperError> {
        let failed = |cause| PaperError::Read {
            path: self.trials.clone(),
            cause,
        };
        let mut trials = BTreeMap::new();
        for entry in fs::read_dir(&self.trials).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            // Unfinished files of an interruption have another extension.
            if path.extension().is_some_and(|ending| ending == "json") {
                let bytes = fs::read(&path).map_err(|cause| PaperError::Read {
                    path: path.clone(),
                    cause,
                })?;
                let trial: ExperimentTrial = parse(&path, &bytes)?;
                trials.insert(trial.number, trial);
            }
        }
        Ok(trials)
    }

    /// Stores a finished trial.
    pub(crate) fn keep(&self, trial: &ExperimentTrial) -> Result<(), PaperError> {
        let path = self.trials.join(format!("{:04}.json", trial.number));
        Ok(output::write_json(&path, trial)?)
    }
}

/// Reads a file that this program wrote.
pub(crate) fn parse<T: serde::de::DeserializeOwned>(
    path: &Path,
    bytes: &[u8],
) -> Result<T, PaperError> {
    serde_json::from_slice(bytes).map_err(|cause| PaperError::NotOurs {
        path: path.to_owned(),
        cause,
    })
}

/// One run through all loads with one seed, all modes in turn.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ExperimentTrial {
    /// Number of the trial, from 1.
    pub(crate) number: u32,
    /// Seed of the script.
    pub(crate) seed: u64,
    /// Duration, seconds.
    pub(crate) wall_s: f64,
    /// Loads in ascending order.
    pub(crate) loads: Vec<LoadOutcome>,
}

/// Outcomes at one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LoadOutcome {
    /// Balls in the pit.
    pub(crate) load: u32,
    /// Modes in the order of the settings.
    pub(crate) modes: Vec<ModeOutcome>,
}

/// One mode at one load. Times are milliseconds; bytes include headers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ModeOutcome {
    /// Name of the mode.
    pub(crate) mode: String,
    /// Number of measured frames.
    pub(crate) frames: u32,
    /// Mean time from calling advance to having every pose of the returned frame.
    pub(crate) phys_ft_ms: f64,
    /// Median of the same.
    pub phys_ft_p50_ms: f64,
    /// 99th percentile of the same.
    pub phys_ft_p99_ms: f64,
    /// Maximum of the same.
    pub(crate) phys_ft_max_ms: f64,
    /// Mean processor time of the caller's thread; the rest is waiting. `None` where the system does not report it.
    pub(crate) work_ms: Option<f64>,
    /// Frames over their time, each counted as 1/11.33 s at least.
    pub(crate) sim_fps: f64,
    /// The same, limited by the server's time too: the rate that a pipelined caller can sustain.
    pub(crate) sustained_fps: f64,
    /// Engine steps per frame.
    pub(crate) step_ms: f64,
    /// Time of observing per frame.
    pub(crate) observe_ms: f64,
    /// Time of selecting, encoding and queueing per frame.
    pub(crate) publish_ms: f64,
    /// Bodies awake at the end.
    pub(crate) awake: u32,
    /// Bytes on the wire to the caller.
    pub(crate) bytes_down: u64,
    /// Bytes on the wire to the server.
    pub(crate) bytes_up: u64,
    /// Datagrams to the caller.
    pub(crate) datagrams_down: u64,
    /// Updates sent.
    pub(crate) updates: u64,
    /// Client of the paper's protocol: frames whose end message was lost.
    #[serde(default)]
    pub(crate) ends_lost: u64,
    /// Digest of all states of its engine so far.
    pub(crate) truth: String,
    /// True if its engine diverged from the integrated one; such an outcome is excluded.
    pub(crate) void: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::tests::settings;

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("rhumb-paper-{name}-{}", std::process::id()));
        // The folder may not exist yet.
        let _ = fs::remove_dir_all(&folder);
        folder
    }

    fn trial(number: u32) -> ExperimentTrial {
        ExperimentTrial {
            number,
            seed: u64::from(number),
            wall_s: 1.0,
            loads: Vec::new(),
        }
    }

    #[test]
    fn finished_trials_are_read_back_and_unfinished_ones_are_ignored() {
        let out = folder("again");
        let store = Store::open(&out, &settings()).unwrap();
        store.keep(&trial(1)).unwrap();
        store.keep(&trial(3)).unwrap();
        fs::write(out.join("trials/0002.partial"), b"{\"number\": 2").unwrap();
        let again = Store::open(&out, &settings()).unwrap().trials().unwrap();
        assert_eq!(again.keys().copied().collect::<Vec<_>>(), [1, 3]);
        fs::write(out.join("trials/0004.json"), b"{\"number\": 4").unwrap();
        let message = store.trials().unwrap_err().to_string();
        assert!(message.contains("0004.json"), "{message}");
        fs::remove_dir_all(&out).unwrap();
    }

    #[test]
    fn another_experiment_is_refused_with_the_difference() {
        let out = folder("other");
        Store::open(&out, &settings()).unwrap();
        let other = Settings {
            machine: "another machine".to_owned(),
            ..settings()
        };
        let message = Store::open(&out, &other).unwrap_err().to_string();
        assert!(message.contains("machine"), "{message}");
        assert!(message.contains("another machine"), "{message}");
        fs::remove_dir_all(&out).unwrap();
    }
}
