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
//! The viewer layout that Foxglove or Lichtblick opens for a trace. Viewers hide scene topics by default, so the
//! layout enables them: the engine's world on the left, a client's copy on the right, and plots of bytes, errors and
//! frame time below.
//!
//! Names of loads and runs in topics and metadata are distinct: the second `rhumb` run of a load is `rhumb-2`.

mod run;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};
use std::{fmt, fs, io};

use mcap::McapError;
use rhumb_reckoning::{BodyId, Tick};
use rhumb_trace::{ASLEEP, AWAKE, GridHistory, SceneTopics, StateForm, States, TraceFile};
use serde_json::{Value, json};

use crate::record::{Experiment, Load, Mode, Replayed, Run, SubscriptionSettings};
use crate::summary::DATAGRAM_HEADER_BYTES;
use run::{Body, RunTopics, Time, TruthBodies};

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
    let (name, record) = metadata_of_experiment(experiment, &prefixes);
    file.put_metadata(name, record)?;
    let mut place = 0;
    for (load, prefix) in experiment.loads.iter().zip(&prefixes) {
        let (name, record) = metadata_of_truth(prefix, load);
        file.put_metadata(name, record)?;
        for (run, name) in load.runs.iter().zip(run_names(load)) {
            let (name, record) = metadata_of_run(prefix, &name, place, run);
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

/// The file while it is written.
#[derive(Debug)]
struct Partial {
    path: PathBuf,
    named: PathBuf,
    sink: BufWriter<File>,
    finished: bool,
}

impl Partial {
    /// Opens `named` with `.partial` appended; replaces an existing file.
    fn create(named: &Path) -> Result<Self, TraceError> {
        let mut path = OsString::from(named);
        path.push(".partial");
        let path = PathBuf::from(path);
        match File::create(&path) {
            Ok(file) => Ok(Self {
                path,
                named: named.to_owned(),
                sink: BufWriter::new(file),
                finished: false,
            }),
            Err(cause) => Err(TraceError::Create { path, cause }),
        }
    }

    /// The writer of the unfinished file.
    fn sink(&mut self) -> &mut BufWriter<File> {
        &mut self.sink
    }

    /// The temporary path.
    fn path(&self) -> &Path {
        &self.path
    }

    /// Renames the file to its final name; returns its size in bytes.
    fn finish(mut self) -> Result<u64, TraceError> {
        let path = self.path.clone();
        let whole = self.sink.flush().and_then(|()| {
            self.sink.get_ref().sync_all()?;
            Ok(self.sink.get_ref().metadata()?.len())
        });
        let bytes = whole.map_err(|cause| TraceError::Write { path, cause })?;
        if let Err(cause) = fs::rename(&self.path, &self.named) {
            return Err(TraceError::Rename {
                path: self.named.clone(),
                cause,
            });
        }
        self.finished = true;
        Ok(bytes)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        if !self.finished {
            // The caller already has the error that matters.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// The cause and the file. A failed trace never keeps its final name.
#[derive(Debug)]
pub enum TraceError {
    /// The file could not be created.
    Create {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// Writing failed, most often because of a full disk.
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
    /// The data exceed what the file format can hold.
    Format {
        /// Path of the file.
        path: PathBuf,
        /// Error of the format's library.
        cause: Box<McapError>,
    },
    /// The finished file could not be renamed.
    Rename {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        cause: io::Error,
    },
}

impl TraceError {
    /// Separates the operating system's errors from the format's.
    fn writing(path: &Path, cause: McapError) -> Self {
        let path = path.to_owned();
        match cause {
            McapError::Io(cause) => Self::Write { path, cause },
            other => Self::Format {
                path,
                cause: Box::new(other),
            },
        }
    }
}

impl fmt::Display for TraceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Create { path, cause } => write!(f, "cannot create {}: {cause}", path.display()),
            Self::Write { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Format { path, cause } => write!(f, "cannot write {}: {cause}", path.display()),
            Self::Rename { path, cause } => write!(f, "cannot rename {}: {cause}", path.display()),
        }
    }
}

impl std::error::Error for TraceError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Create { cause, .. } | Self::Write { cause, .. } | Self::Rename { cause, .. } => {
                Some(cause)
            }
            Self::Format { cause, .. } => Some(cause),
        }
    }
}

/// Name and content of the metadata record of the experiment.
fn metadata_of_experiment(
    experiment: &Experiment,
    loads: &[String],
) -> (String, BTreeMap<String, String>) {
    let pairs = [
        ("command", experiment.command.clone()),
        ("seed", experiment.seed.to_string()),
        ("machine", experiment.machine.clone()),
        ("loads", loads.join(" ")),
        ("datagram_header_bytes", DATAGRAM_HEADER_BYTES.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    ("rhumb.experiment".to_owned(), named(pairs))
}

/// Name and content of the metadata record of a load's truth.
fn metadata_of_truth(prefix: &str, load: &Load) -> (String, BTreeMap<String, String>) {
    let pairs = [
        ("truth_hash", format!("{:016x}", load.truth.digest)),
        ("ticks", load.truth.ticks.len().to_string()),
        ("placed", load.truth.placed.len().to_string()),
        ("removed", load.truth.removed.len().to_string()),
    ];
    let mut record = named(pairs);
    record.extend(load.facts.to_metadata());
    (format!("rhumb.truth.{prefix}"), record)
}

/// Name and content of the metadata record of a run; `place` is its index in the summary, from 0.
fn metadata_of_run(
    prefix: &str,
    name: &str,
    place: usize,
    run: &Run,
) -> (String, BTreeMap<String, String>) {
    let (config, join) = (&run.config, &run.join);
    let mut record = named([
        ("place", place.to_string()),
        ("load", prefix.to_owned()),
        ("name", name.to_owned()),
        ("scene", config.scene.clone()),
        ("bodies", config.bodies.to_string()),
        ("mode", config.mode.name().to_owned()),
        ("depth", config.depth.to_string()),
        ("link", config.link.clone()),
        ("seed", config.seed.to_string()),
        ("step_s", config.step_s.to_string()),
        ("ticks", config.ticks.to_string()),
        ("frames", run.frames.len().to_string()),
        ("truth_hash", format!("{:016x}", run.truth_checksum)),
        ("join_wire_bytes_down", join.wire_bytes_down.to_string()),
        (
            "join_wire_datagrams_down",
            join.wire_datagrams_down.to_string(),
        ),
        ("join_wire_bytes_up", join.wire_bytes_up.to_string()),
        ("join_wire_datagrams_up", join.wire_datagrams_up.to_string()),
        ("step_ns_p50", run.step_ns_p50.to_string()),
        ("step_ns_p99", run.step_ns_p99.to_string()),
        ("step_ns_total", run.step_ns_total.to_string()),
        ("publish_ns_total", run.publish_ns_total.to_string()),
        ("mismatches", run.mismatches.to_string()),
    ]);
    if let Some(tolerance_m) = config.tolerance_m {
        record.insert("tolerance_m".to_owned(), tolerance_m.to_string());
    }
    if let Some(budget) = config.budget_bytes_per_second {
        record.insert("budget_bytes_per_second".to_owned(), budget.to_string());
    }
    if let Some(subscription) = &config.subscription {
        record.extend(of_subscription(subscription));
    }
    if let Some(replayed) = &config.replayed {
        record.extend(of_replay(replayed));
    }
    (format!("rhumb.run.{prefix}.{name}"), record)
}

/// Publish and subscribe settings of a free-running scene.
fn of_subscription(subscription: &SubscriptionSettings) -> BTreeMap<String, String> {
    named([
        (
            "publish_interval",
            subscription.publish_interval.to_string(),
        ),
        ("lookahead_ticks", subscription.lookahead_ticks.to_string()),
        ("delay_ticks", subscription.delay_ticks.to_string()),
    ])
}

/// Settings that only a replay has.
fn of_replay(replayed: &Replayed) -> BTreeMap<String, String> {
    let mut record = named([
        ("publish_interval", replayed.publish_interval.to_string()),
        ("lookahead_ticks", replayed.lookahead_ticks.to_string()),
        ("link_seed", replayed.link_seed.to_string()),
        ("without", replayed.without.join(" ")),
    ]);
    let parts = [
        ("position_m", replayed.position_m),
        ("turn_rad", replayed.turn_rad),
    ];
    for (name, value) in parts {
        record.extend(value.map(|value| (name.to_owned(), value.to_string())));
    }
    record
}

fn named<const COUNT: usize>(pairs: [(&str, String); COUNT]) -> BTreeMap<String, String> {
    pairs.map(|(name, value)| (name.to_owned(), value)).into()
}

/// The text of `layout.json`: the smallest load, with its truth and its first copy that states a tolerance.
#[must_use]
pub fn layout(experiment: &Experiment) -> String {
    let bodies = |load: &Load| load.runs.first().map_or(u32::MAX, |run| run.config.bodies);
    let loads = load_names(experiment);
    let smallest = experiment
        .loads
        .iter()
        .zip(&loads)
        .min_by_key(|(load, _)| bodies(load));
    let mut text = match smallest {
        Some((load, prefix)) => format!("{:#}", window(load, prefix)),
        None => format!("{:#}", json!({})),
    };
    text.push('\n');
    text
}

fn window(load: &Load, prefix: &str) -> Value {
    let runs: Vec<_> = load.runs.iter().zip(run_names(load)).collect();
    let remote = || {
        runs.iter()
            .filter(|(run, _)| run.config.mode != Mode::Integrated)
    };
    let reckoned = remote().find(|(run, _)| run.config.tolerance_m.is_some());
    let copy = reckoned
        .or_else(|| remote().next())
        .map_or("truth", |(_, name)| name);
    let all = || runs.iter().map(|(_, name)| name.as_str()).collect();
    let copies = || remote().map(|(_, name)| name.as_str()).collect();
    let of_copy = "Client's copy: blue is exact, red is at the tolerance, violet is beyond";
    let of = |title, field, names: Vec<_>| plot(title, field, prefix, &names);
    let bytes = of(
        "Bytes down per frame, UDP payload",
        "wire_bytes_down",
        copies(),
    );
    let error = of("Largest surface error, metres", "error_m_max", copies());
    let panels = [
        ("3D!truth", drawn("Truth", prefix, "truth")),
        ("3D!copy", drawn(of_copy, prefix, copy)),
        ("Plot!bytes", bytes),
        ("Plot!error", error),
        (
            "Plot!frame",
            of("Frame time, nanoseconds", "frame_ns", all()),
        ),
    ];
    let panels = panels.map(|(name, panel)| (name.to_owned(), panel));
    let shares = json!({
        "direction": "column", "splitPercentage": 65,
        "first": { "direction": "row", "first": "3D!truth", "second": "3D!copy" },
        "second": {
            "direction": "row", "splitPercentage": 34, "first": "Plot!bytes",
            "second": { "direction": "row", "first": "Plot!error", "second": "Plot!frame" }
        }
    });
    rhumb_trace::whole_layout(&panels.into_iter().collect(), &shares)
}

/// A 3D panel that shows the topics of one copy or of the truth.
fn drawn(title: &str, prefix: &str, name: &str) -> Value {
    let of_copy = ["moving", "resting"].map(|of| format!("/{prefix}/{name}/{of}"));
    let statics = format!("/{prefix}/truth/static");
    rhumb_trace::drawing_panel(title, of_copy.into_iter().chain([statics]))
}

/// A panel with a line for each run.
fn plot(title: &str, field: &str, prefix: &str, names: &[&str]) -> Value {
    let path = |name: &&str| {
        json!({
            "value": format!("/{prefix}/{name}/stats.{field}"), "label": name, "enabled": true,
            "timestampMethod": "receiveTime", "showLine": true
        })
    };
    json!({
        "foxglovePanelTitle": title, "paths": names.iter().map(path).collect::<Vec<_>>(), "xAxisVal": "timestamp",
        "isSynced": true, "showLegend": true, "legendDisplay": "floating", "showXAxisLabels": true,
        "showYAxisLabels": true, "showPlotValuesInLegend": false, "sidebarDimension": 240
    })
}

/// Prefix of each load, such as `n500`, in the order of the record.
pub(crate) fn load_names(experiment: &Experiment) -> Vec<String> {
    let bodies = |load: &Load| load.runs.first().map_or(0, |run| run.config.bodies);
    distinct(
        experiment
            .loads
            .iter()
            .map(|load| format!("n{}", bodies(load))),
    )
}

/// Name of each run of a load, such as `rhumb`, in the order of the record.
pub(crate) fn run_names(load: &Load) -> Vec<String> {
    distinct(
        load.runs
            .iter()
            .map(|run| run.config.mode.name().to_owned()),
    )
}

fn distinct(names: impl Iterator<Item = String>) -> Vec<String> {
    let mut taken: BTreeMap<String, u32> = BTreeMap::new();
    names
        .map(|name| {
            let count = taken.entry(name.clone()).or_default();
            *count += 1;
            if *count == 1 {
                name
            } else {
                format!("{name}-{count}")
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {

    #[test]
    fn names_are_distinct() {
        let names = ["naive", "rhumb", "rhumb"].map(str::to_owned);
        assert_eq!(
            super::distinct(names.into_iter()),
            ["naive", "rhumb", "rhumb-2"]
        );
    }
}
