//! The figures of an experiment, as `summary.json` holds them.
//!
//! Computed from the record alone. A figure without meaning for a mode is `null`: a scene stepped in the caller's
//! thread sends no bytes. A percentile is the least measured value that the given share does not exceed.

mod run_figures;
mod table;

use serde::{Deserialize, Serialize};

use crate::numbers::{aligned, pretty_json};
use crate::record::Experiment;
use run_figures::{compare_with_naive, figures_of_run};

pub(crate) use run_figures::second_by_second;
pub use run_figures::{
    DATAGRAM_HEADER_BYTES, ErrorQuantiles, FirstSeconds, FrameTimes, Join, LessThanNaive, Moving,
    OfLimit, OverTolerance, Recovery, RunFigures, SIM_FPS_MAX, StepTimes,
};
pub(crate) use table::{Column, columns};
pub use table::{SummaryTable, UnfinishedReplay, later, ratios};

/// Figures of one experiment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The command line, as typed.
    pub command: String,
    /// Seed of the scripts.
    pub seed: u64,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Every mode's run of every load, in the order of the record.
    pub runs: Vec<RunFigures>,
    /// Failed replays, which have no figures; omitted if there are none.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unfinished: Vec<UnfinishedReplay>,
}

impl Summary {
    /// Computes the figures of an experiment.
    #[must_use]
    pub fn of(experiment: &Experiment) -> Self {
        let runs = experiment.loads.iter().flat_map(|load| {
            let figures = |run| figures_of_run(run, load.truth.digest);
            load.runs.iter().map(figures)
        });
        let mut runs: Vec<_> = runs.collect();
        compare_with_naive(&mut runs);
        let unfinished = experiment.loads.iter().flat_map(|load| &load.unfinished);
        Self {
            command: experiment.command.clone(),
            seed: experiment.seed,
            machine: experiment.machine.clone(),
            runs,
            unfinished: unfinished.map(UnfinishedReplay::of).collect(),
        }
    }

    /// The text of `summary.json`.
    #[must_use]
    pub fn to_json(&self) -> String {
        pretty_json(self).expect("numbers, texts and maps keyed by texts are always JSON")
    }

    /// True if all runs are replays of recordings.
    #[must_use]
    pub fn is_of_replays(&self) -> bool {
        !self.runs.is_empty() && self.runs.iter().all(|run| run.replayed.is_some())
    }

    /// Reduction of each run against naive, as lines for a terminal; empty without a naive run.
    #[must_use]
    pub fn ratios(&self) -> String {
        let rows = ratios(&self.runs);
        if rows.len() < 2 {
            return String::new();
        }
        format!("\nless than naive, times\n{}", aligned(&rows))
    }

    /// The runs as a table for a terminal.
    #[must_use]
    pub fn table(&self) -> SummaryTable<'_> {
        SummaryTable::new(&self.runs, &self.unfinished)
    }
}
