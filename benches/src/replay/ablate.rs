//! `rhumb-bench ablate`: what each means of a stream is worth.
//!
//! Replays it with everything on, with each means switched off in turn, and with all of them off. The range coder is the
//! wire's own and cannot be switched off: what its numbers would take in plain codes is counted. Grids follow from
//! tolerances, and what sleeps is told at rest, in every row.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;

use super::{
    EnabledFeatures, Failure, Feature, RecordingSource, ReplayOptions, ReplayRetention, ended,
    run_all,
};
use crate::limit::set_beside_limits;
use crate::output;

/// Which recording, how it is published, and where to write what came of it.
#[derive(Clone, Debug, Args)]
pub struct Ablate {
    #[command(flatten)]
    source: RecordingSource,
    #[command(flatten)]
    options: ReplayOptions,
    /// Folder for summary.json and report.html; made if it is not there.
    #[arg(long, default_value = "results/ablate")]
    out: PathBuf,
    /// Do not compare with how little would have done, had the future been known.
    #[arg(long)]
    no_limit: bool,
}

/// Replays. Exit code 0 when everything was replayed and written, 1 otherwise.
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

/// Everything, everything but one, nothing.
fn rows() -> impl Iterator<Item = EnabledFeatures> {
    let singly = Feature::ALL
        .into_iter()
        .map(|feature| Feature::all_but(&[feature]));
    std::iter::once(EnabledFeatures::ALL)
        .chain(singly)
        .chain([Feature::all_but(&Feature::ALL)])
}
