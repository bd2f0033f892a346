//! Writes `trace.mcap`: an experiment to watch and to compute from.
//!
//! Each load has a prefix such as `/n500`. Below it, for each tick or frame:
//!
//! | topic | message | holds |
//! |---|---|---|
//! | `truth/state` | `rhumb.States` | engine states: bit exact in the first load, poses on a grid in others |
//! | `truth/static`, `truth/moving`, `truth/resting` | `foxglove.SceneUpdate` | the same states, drawn |
//! | `{mode}/moving`, `{mode}/resting` | `foxglove.SceneUpdate` | the client's copy, coloured by error over tolerance |
//! | `{mode}/stats` | `rhumb.TickStats` | bytes, updates, errors, frame time |
//! | `{mode}/seen` | `rhumb.Poses` | the poses that changed in the client's copy, on the grid |
//! | `{mode}/breaches` | `rhumb.Breach` | body-ticks over tolerance |
//! | `{mode}/wire/{way}` | `rhumb.Packet` | every datagram and piece of control stream; of states alone, the size |
//!
//! Metadata records are `rhumb.experiment`, `rhumb.truth.n500`, `rhumb.run.n500.{mode}`. The messages are those of
//! `rhumb.proto` of `rhumb-trace`. Every figure of the summary can be computed from the file. The file is written under a
//! temporary name and renamed once complete.

mod bodies;
mod error;
mod figures;
mod layout;
mod load;
mod metadata;
mod names;
mod options;
mod partial;
mod run;
mod time;

use std::io::{Seek, Write};
use std::path::Path;

use mcap::McapError;
use rhumb_trace::{GridHistory, StateForm, TraceFile};

use crate::record::Experiment;

pub use error::TraceError;
pub use layout::layout;
use load::{last_tick, write_load};
pub(crate) use names::{load_names, run_names};
pub use options::TraceOptions;
use partial::Partial;

/// Progress of the writing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Ticks written, over all loads.
    pub done: u64,
    /// Ticks to write.
    pub of: u64,
}

/// Writes the trace to `path`; returns its size in bytes.
///
/// An unfinished file carries the suffix `.partial` and is removed on failure.
///
/// # Errors
///
/// [`TraceError`] names the file and the cause.
pub fn write(
    path: &Path,
    experiment: &Experiment,
    options: &TraceOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<u64, TraceError> {
    let mut partial = Partial::create(path)?;
    let written = write_to(partial.sink(), experiment, options, progress);
    written.map_err(|cause| TraceError::writing(partial.path(), cause))?;
    partial.finish()
}

/// The name of this program in a trace.
const LIBRARY: &str = concat!("rhumb-bench/", env!("CARGO_PKG_VERSION"));

/// Writes the trace to any seekable sink.
fn write_to(
    to: impl Write + Seek,
    experiment: &Experiment,
    options: &TraceOptions,
    progress: &mut dyn FnMut(Progress),
) -> Result<(), McapError> {
    let mut file = TraceFile::new(to, LIBRARY)?;
    let prefixes = load_names(experiment);
    let (name, record) = metadata::of_experiment(experiment, &prefixes);
    file.put_metadata(name, record)?;
    let mut place = 0;
    for (load, prefix) in experiment.loads.iter().zip(&prefixes) {
        let (name, record) = metadata::of_truth(prefix, load);
        file.put_metadata(name, record)?;
        for (run, name) in load.runs.iter().zip(run_names(load)) {
            let (name, record) = metadata::of_run(prefix, &name, place, run);
            file.put_metadata(name, record)?;
            place += 1;
        }
    }
    let of = experiment
        .loads
        .iter()
        .map(|load| last_tick(load) + 1)
        .sum();
    let mut done = 0;
    for (place, (load, prefix)) in experiment.loads.iter().zip(&prefixes).enumerate() {
        // A replay reads the first load, and needs its exact states.
        let form = if place == 0 {
            StateForm::Exact
        } else {
            StateForm::Grid(GridHistory::default())
        };
        write_load(&mut file, (prefix, load), form, options, &mut |_| {
            done += 1;
            progress(Progress { done, of });
        })?;
    }
    file.finish()?.flush()?;
    Ok(())
}
