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
//!
//! Topics of one load: the truth and each of its runs, tick by tick.

mod metadata;
mod run;

use std::io::{Seek, Write};
use std::path::Path;

use mcap::McapError;
use rhumb_reckoning::{BodyId, Tick};
use rhumb_trace::{ASLEEP, AWAKE, GridHistory, SceneTopics, StateForm, States, TraceFile};

use crate::record::{Experiment, Load};
use metadata::Partial;
use run::{Body, RunTopics, Time, TruthBodies};

pub use metadata::{TraceError, layout};
pub(crate) use metadata::{load_names, run_names};
pub use run::TraceOptions;

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

/// Writes a load; `done` is called after each tick with its number.
fn write_load<W: Write + Seek>(
    file: &mut TraceFile<W>,
    (prefix, load): (&str, &Load),
    form: StateForm,
    options: &TraceOptions,
    done: &mut dyn FnMut(u64),
) -> Result<(), McapError> {
    if load.runs.is_empty() {
        return Ok(());
    }
    let time = Time::of(load.facts.integrator.rate, options);
    let mut truth = TruthTopics::new((prefix, load), form, time, options);
    let mut runs: Vec<_> = run_names(load)
        .iter()
        .zip(&load.runs)
        .map(|(name, run)| RunTopics::new(&format!("/{prefix}/{name}"), load, run, options))
        .collect();
    for tick in 0..=last_tick(load) {
        truth.write(file, Tick::new(tick))?;
        for run in &mut runs {
            run.write_through(file, tick, &truth.bodies.bodies)?;
        }
        done(tick);
    }
    runs.iter_mut().try_for_each(|run| run.end(file))
}

/// The last tick that the engine simulated or a frame showed.
fn last_tick(load: &Load) -> u64 {
    let shown = load
        .runs
        .iter()
        .flat_map(|run| &run.frames)
        .map(|frame| frame.tick.value());
    shown.max().unwrap_or(0).max(load.truth.ticks.len() as u64)
}

struct TruthTopics<'a> {
    time: Time,
    form: StateForm,
    topics: SceneTopics,
    is_drawn: bool,
    bodies: TruthBodies<'a>,
    last: u64,
    drawn: Option<u64>,
    /// True if a static body was placed or removed since statics were last drawn.
    statics_changed: bool,
}

impl<'a> TruthTopics<'a> {
    fn new(
        (prefix, load): (&str, &'a Load),
        form: StateForm,
        time: Time,
        options: &TraceOptions,
    ) -> Self {
        Self {
            time,
            form,
            topics: SceneTopics::new(&format!("/{prefix}"), time.rest_delay_ticks()),
            is_drawn: options.draws(load),
            bodies: TruthBodies::new(&load.truth),
            last: last_tick(load),
            drawn: None,
            statics_changed: false,
        }
    }

    fn write<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        tick: Tick,
    ) -> Result<(), McapError> {
        let at_ns = self.time.at_ns(tick.value());
        let changes = self.bodies.step(tick);
        self.statics_changed |= changes.statics_changed;
        let removed: Vec<BodyId> = changes.removed.iter().map(|(_, id)| *id).collect();
        let after = (changes.placed, removed.as_slice());
        let states = States::of(tick, changes.observed, after, &mut self.form);
        self.topics.put_states(file, at_ns, &states)?;
        let due = self
            .drawn
            .is_none_or(|drawn| self.time.draws_after(drawn, tick.value()));
        if self.is_drawn && (due || tick.value() == self.last) {
            self.drawn = Some(tick.value());
            let bodies = || self.bodies.bodies.iter();
            if std::mem::take(&mut self.statics_changed) {
                let statics = bodies().filter(|body| body.is_static());
                self.topics
                    .draw_statics(file, at_ns, statics.map(Body::drawn))?;
            }
            let moving = bodies().filter(|body| !body.is_static());
            let painted: Vec<_> = moving
                .map(|body| (body.drawn(), if body.still { ASLEEP } else { AWAKE }))
                .collect();
            self.topics.draw(file, (tick.value(), at_ns), &painted)?;
        }
        Ok(())
    }
}
