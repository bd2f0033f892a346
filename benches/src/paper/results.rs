//! The results of an experiment: `paper.json`.

use serde::{Deserialize, Serialize};

use super::analysis::Analysis;
use super::outcome::ExperimentTrial;
use super::settings::Settings;

/// Results of an experiment: `paper.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct PaperResults {
    /// The command line, as typed.
    pub(super) command: String,
    /// Settings of the experiment.
    pub(super) settings: Settings,
    /// Every finished trial.
    pub(super) trials: Vec<ExperimentTrial>,
    /// Analysis over all trials.
    pub(super) analysis: Analysis,
}
