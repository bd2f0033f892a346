//! `rhumb-bench ablate`: measures the value of each feature of a stream.
//!
//! Replays the recording with all features, with each one switched off in turn, and with none. The range coder is part
//! of the wire format and stays on; its row counts the size of its numbers in plain codes instead. In every row, grids
//! follow from tolerances, and sleeping bodies are sent at rest.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::{
    EnabledFeatures, Failure, Feature, RecordingSource, ReplayOptions, ReplayRetention, ended,
    run_all,
};
use crate::limit::set_beside_limits;
use crate::output;

/// Arguments: recording, publish settings, output.
#[derive(Clone, Debug, Args)]
pub struct Ablate {
    #[command(flatten)]
    source: RecordingSource,
    #[command(flatten)]
    options: ReplayOptions,
    /// Folder for summary.json and report.html; created if missing.
    #[arg(long, default_value = "results/ablate")]
    out: PathBuf,
    /// Skip the comparison with the limit for a known future.
    #[arg(long)]
    no_limit: bool,
}

/// Runs the replays. Exit code 0 if everything was replayed and written, 1 otherwise.
pub fn ablate(arguments: &Ablate) -> ExitCode {
    ended(ablate_all(arguments))
}

fn ablate_all(arguments: &Ablate) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let config = rows().map(|features| arguments.options.config(features));
    let all = config
        .collect::<Result<Vec<_>, _>>()
        .map_err(Failure::Terms)?;
    let recording = arguments.source.read()?;
    let mut replays = run_all(&recording, &all, ReplayRetention::Figures)?;
    if !arguments.no_limit {
        set_beside_limits(&recording, replays.promised());
    }
    replays.write(recording, arguments.options.seed(), &arguments.out, None)
}

/// All features, all but one, none.
fn rows() -> impl Iterator<Item = EnabledFeatures> {
    let singly = Feature::ALL
        .into_iter()
        .map(|feature| Feature::all_but(&[feature]));
    std::iter::once(EnabledFeatures::ALL)
        .chain(singly)
        .chain([Feature::all_but(&Feature::ALL)])
}
