//! Settings and stored outcomes of an experiment, and the errors of its tasks.
//!
//! Trials of other settings are never mixed with these.
//!
//! Each file is written whole or not at all. Trials of other settings or another machine are refused.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::{fmt, fs, io};

use rhumb_bench::drive::DriveError;
use rhumb_bench::output::{self, OutputError};
use rhumb_bench::record::Mode;
use rhumb_reckoning::{Metres, Tolerance};
use rhumb_server::RunError;
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
    setting: String,
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

/// Checks a length in metres as a tolerance.
pub(crate) fn tolerance(metres: f64) -> Result<Tolerance, PaperError> {
    Tolerance::from_metres(Metres::new(metres)).map_err(|error| PaperError::Tolerance {
        metres,
        cause: error.to_string(),
    })
}

/// Balls in the pit, stage by stage: consecutive multiples of the first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Loads(Vec<u32>);

/// Largest load; more would not fit into a scene beside the walls.
const LOAD_MAX: u32 = 100_000;

impl Loads {
    /// The first `count` multiples of `first`.
    pub(crate) fn multiples(first: u32, count: u32) -> Self {
        Self((1..=count).map(|stage| first * stage).collect())
    }

    pub(crate) fn as_slice(&self) -> &[u32] {
        &self.0
    }
}

impl FromStr for Loads {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| -> Result<u32, String> {
            let failed = |_| format!("{text:?} is not a number of balls");
            let load = text.trim().parse().map_err(failed)?;
            if (1..=LOAD_MAX).contains(&load) {
                Ok(load)
            } else {
                Err(format!("a load must lie between 1 and {LOAD_MAX} balls"))
            }
        };
        let loads = match text.split_once("..") {
            Some((first, last)) => {
                let (first, last) = (number(first)?, number(last)?);
                if !last.is_multiple_of(first) {
                    return Err(format!("{last} is not a multiple of {first}"));
                }
                Self::multiples(first, last / first).0
            }
            None => text.split(',').map(number).collect::<Result<_, _>>()?,
        };
        let first = loads[0];
        let fits =
            |(stage, load): (u32, &u32)| u64::from(*load) == u64::from(first) * u64::from(stage);
        if (1..).zip(&loads).all(fits) {
            Ok(Self(loads))
        } else {
            Err(format!(
                "loads must be consecutive multiples of the first, since each stage adds as many balls: {}",
                Self::multiples(first, loads.len() as u32)
                    .0
                    .iter()
                    .map(u32::to_string)
                    .collect::<Vec<_>>()
                    .join(",")
            ))
        }
    }
}

/// The error of a task.
#[derive(Debug)]
pub(crate) enum PaperError {
    /// A run failed.
    Drive(DriveError),
    /// The cores cannot be chosen.
    Cores(RunError),
    /// An output cannot be written.
    Output(OutputError),
    /// A file or folder cannot be read.
    Read { path: PathBuf, cause: io::Error },
    /// A file has another format than this program writes.
    NotOurs {
        path: PathBuf,
        cause: serde_json::Error,
    },
    /// The folder holds trials of other settings or of another machine.
    OtherExperiment {
        folder: PathBuf,
        difference: Difference,
    },
    /// A mode cannot take part.
    NotPlayable { mode: Mode },
    /// The baseline mode is missing.
    NoIntegrated,
    /// The tolerance is invalid.
    Tolerance { metres: f64, cause: String },
    /// The merge has no input, or inconsistent input.
    Merge { why: String },
    /// A page's markers are wrong.
    Page { path: PathBuf, why: String },
    /// A page is stale.
    Stale { path: PathBuf, blocks: Vec<String> },
    /// The caller cannot be slowed.
    Quota { why: String },
}

impl fmt::Display for PaperError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Drive(cause) => cause.fmt(f),
            Self::Cores(cause) => write!(f, "{cause}; tasks with --no-pin let the system choose"),
            Self::Output(cause) => cause.fmt(f),
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::NotOurs { path, cause } => write!(
                f,
                "{} does not have the format that this program writes: {cause}",
                path.display()
            ),
            Self::OtherExperiment { folder, difference } => write!(
                f,
                "{} holds trials of another experiment ({difference}); choose another --out, or remove it",
                folder.display()
            ),
            Self::NotPlayable { mode } => write!(f, "{mode} cannot take part in this experiment"),
            Self::NoIntegrated => {
                f.write_str("--modes must name integrated: all others are compared with it")
            }
            Self::Tolerance { metres, cause } => write!(f, "a tolerance of {metres} m: {cause}"),
            Self::Merge { why } => write!(f, "cannot merge: {why}"),
            Self::Page { path, why } => write!(f, "{}: {why}", path.display()),
            Self::Stale { path, blocks } => write!(
                f,
                "{path} is stale: {}; `rhumb-paper page {path}` updates it",
                blocks.join(", "),
                path = path.display(),
            ),
            Self::Quota { why } => write!(f, "the caller cannot be slowed: {why}"),
        }
    }
}

impl From<DriveError> for PaperError {
    fn from(cause: DriveError) -> Self {
        Self::Drive(cause)
    }
}

impl From<OutputError> for PaperError {
    fn from(cause: OutputError) -> Self {
        Self::Output(cause)
    }
}

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

    #[test]
    fn loads_are_multiples_in_every_notation() {
        let read = |text: &str| text.parse::<Loads>().map(|loads| loads.0);
        assert_eq!(read("500"), Ok(vec![500]));
        assert_eq!(read("500..2000"), Ok(vec![500, 1_000, 1_500, 2_000]));
        assert_eq!(read("10, 20,30"), Ok(vec![10, 20, 30]));
        for wrong in [
            "",
            "0",
            "500,1500",
            "1000,500",
            "500..1200",
            "5..x",
            "200000",
            "70000,140000",
        ] {
            assert!(read(wrong).is_err(), "{wrong}");
        }
        assert!(read("500,1500").unwrap_err().ends_with("500,1000"));
    }

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
