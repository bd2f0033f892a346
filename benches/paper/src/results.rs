//! The results of an experiment: `paper.json`.

use serde::{Deserialize, Serialize};

use super::analysis::Analysis;
use super::outcome::ExperimentTrial;
use super::settings::Settings;

/// Results of an experiment: `paper.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct PaperResults {
    /// The command line, as typed.
    pub(crate) command: String,
    /// Settings of the experiment.
    pub(crate) settings: Settings,
    /// Every finished trial.
    pub(crate) trials: Vec<ExperimentTrial>,
    /// Analysis over all trials.
    pub(crate) analysis: Analysis,
}
