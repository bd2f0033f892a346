//! Trials kept as they end, so that an experiment goes on where it was.
//!
//! Each file is there whole or not at all. Trials of other settings or another machine are never mixed in.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::PaperError;
use super::outcome::ExperimentTrial;
use super::settings::Settings;
use crate::output;

/// An experiment's folder.
#[derive(Debug)]
pub(super) struct Store {
    trials: PathBuf,
}

impl Store {
    /// Opens a folder for these settings, and makes it if it is not there.
    pub(super) fn open(out: &Path, settings: &Settings) -> Result<Self, PaperError> {
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

    /// The trials that have ended so far, by number.
    pub(super) fn trials(&self) -> Result<BTreeMap<u32, ExperimentTrial>, PaperError> {
        let failed = |cause| PaperError::Read {
            path: self.trials.clone(),
            cause,
        };
        let mut trials = BTreeMap::new();
        for entry in fs::read_dir(&self.trials).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            // What an interruption left unfinished has another ending.
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

    /// Keeps a trial that has ended.
    pub(super) fn keep(&self, trial: &ExperimentTrial) -> Result<(), PaperError> {
        let path = self.trials.join(format!("{:04}.json", trial.number));
        Ok(output::write_json(&path, trial)?)
    }
}

/// Reads a file that this program wrote.
pub(super) fn parse<T: serde::de::DeserializeOwned>(
    path: &Path,
    bytes: &[u8],
) -> Result<T, PaperError> {
    serde_json::from_slice(bytes).map_err(|cause| PaperError::NotOurs {
        path: path.to_owned(),
        cause,
    })
}

#[cfg(test)]
mod tests {
    use super::super::settings::tests::settings;
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("rhumb-paper-{name}-{}", std::process::id()));
        // It may not be there yet.
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
    fn trials_that_ended_are_there_again_and_half_ones_are_not() {
        let out = folder("again");
        let store = Store::open(&out, &settings()).unwrap();
        store.keep(&trial(1)).unwrap();
        store.keep(&trial(3)).unwrap();
        fs::write(out.join("trials/0002.partial"), b"{\"number\": 2").unwrap();
        let again = Store::open(&out, &settings()).unwrap().trials().unwrap();
        assert_eq!(again.keys().copied().collect::<Vec<_>>(), [1, 3]);
        fs::write(out.join("trials/0004.json"), b"{\"number\": 4").unwrap();
        let said = store.trials().unwrap_err().to_string();
        assert!(said.contains("0004.json"), "{said}");
        fs::remove_dir_all(&out).unwrap();
    }

    #[test]
    fn another_experiment_is_refused_by_what_differs() {
        let out = folder("other");
        Store::open(&out, &settings()).unwrap();
        let other = Settings {
            machine: "another machine".to_owned(),
            ..settings()
        };
        let said = Store::open(&out, &other).unwrap_err().to_string();
        assert!(said.contains("machine"), "{said}");
        assert!(said.contains("another machine"), "{said}");
        fs::remove_dir_all(&out).unwrap();
    }
}
