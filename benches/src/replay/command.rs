//! `rhumb-bench replay`: publishes a recorded scene and subscribes to it.
//!
//! No engine steps and no socket opens: time is simulated, and one seed gives one result, bit exact.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;

use crate::limit::{Promised, set_beside_limits};
use crate::machine;
use crate::output;
use crate::record::{Experiment, Load, Run, Unfinished};
use crate::recording::Recording;

/// Arguments: recording, settings, output.
#[derive(Clone, Debug, Args)]
pub struct Replay {
    #[command(flatten)]
    source: RecordingSource,
    #[command(flatten)]
    options: ReplayOptions,
    /// Switch these features off.
    #[arg(long, value_delimiter = ',')]
    without: Vec<Feature>,
    /// Send no repair symbols: the same as `--without fec`.
    #[arg(long)]
    no_fec: bool,
    /// Replay once for each value, such as tolerance=0.005,0.01,0.02 or loss=0%,1%,5%; other settings: turn,
    /// publish-interval, seed, budget (none or bytes per second), and the parts of a link.
    #[arg(long, conflicts_with = "matrix")]
    sweep: Option<Sweep>,
    /// Replay once for each loss of 0, 1, 5 and 20 %, even and in bursts of 4, at round trips of 0, 50, 100 and 300
    /// ms.
    #[arg(long)]
    matrix: bool,
    /// Folder for summary.json, report.html, trace.mcap and its layout; created if missing.
    #[arg(long, default_value = "results/replay")]
    out: PathBuf,
    /// Write no trace.
    #[arg(long)]
    no_trace: bool,
    /// Skip the comparison with the limit for a known future.
    #[arg(long)]
    no_limit: bool,
}

/// Runs the replays. Exit code 0 if everything was replayed and written, 1 otherwise.
pub fn replay(arguments: &Replay) -> ExitCode {
    ended(replay_all(arguments))
}

fn replay_all(arguments: &Replay) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let all = settings(arguments)?;
    if !arguments.no_trace {
        arguments.source.refuse_overwriting(&arguments.out)?;
    }
    let recording = arguments.source.read()?;
    let keep = if arguments.no_trace {
        ReplayRetention::Figures
    } else {
        ReplayRetention::Everything
    };
    let mut replays = run_all(&recording, &all, keep)?;
    if !arguments.no_limit {
        set_beside_limits(&recording, replays.promised());
    }
    let drawn = (!arguments.no_trace).then_some(recording.bodies());
    replays.write(recording, arguments.options.seed(), &arguments.out, drawn)
}

/// The data of each replay that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum ReplayRetention {
    /// Everything that a trace holds.
    Everything,
    /// Only the data for the figures, no poses.
    Figures,
}

/// Results of all replays of one recording.
#[derive(Debug, Default)]
struct Replays {
    /// Finished replays in order, with their configs.
    ended: Vec<(ReplayConfig, Run)>,
    /// Failed replays.
    unfinished: Vec<Unfinished>,
}

/// Replays the recording under each config. A failed replay does not stop the others; it is an error if all fail.
fn run_all(
    recording: &Recording,
    all: &[ReplayConfig],
    keep: ReplayRetention,
) -> Result<Replays, Failure> {
    let mut replays = Replays::default();
    let mut first_error = None;
    for (number, config) in all.iter().enumerate() {
        let what = format!("replay {} of {}", number + 1, all.len());
        let bar = output::progress_bar(u64::from(recording.ticks()), what);
        match run(recording, config, &mut |_| bar.inc(1)) {
            Ok(mut run) => {
                if keep == ReplayRetention::Figures {
                    for frame in &mut run.frames {
                        (frame.changed, frame.removed) = (Vec::new(), Vec::new());
                    }
                }
                replays.ended.push((*config, run));
            }
            Err(error) => {
                first_error.get_or_insert(error);
                replays.unfinished.push(Unfinished {
                    config: config.run_config(recording),
                    cause: error.to_string(),
                });
            }
        }
        bar.finish_and_clear();
    }
    match first_error {
        Some(error) if replays.ended.is_empty() => Err(Failure::Replay(all.len(), error)),
        _ => Ok(replays),
    }
}

impl Replays {
    /// The finished replays, with their tolerances.
    fn promised(&mut self) -> impl Iterator<Item = (&mut Run, Option<Promised>)> {
        let ended = self.ended.iter_mut();
        ended.map(|(config, run)| (run, Some((config.tolerance, config.publish_interval))))
    }

    /// Prints and writes all results; `drawn` is the largest body count drawn in a trace. An error if any replay
    /// failed.
    fn write(
        self,
        recording: Recording,
        seed: u64,
        out: &Path,
        drawn: Option<u32>,
    ) -> Result<(), Failure> {
        let (unfinished, all) = (
            self.unfinished.len(),
            self.ended.len() + self.unfinished.len(),
        );
        let experiment = Experiment {
            command: output::command_line(),
            seed,
            machine: machine::describe(),
            loads: vec![Load {
                facts: recording.facts(),
                truth: recording.truth,
                runs: self.ended.into_iter().map(|(_, run)| run).collect(),
                unfinished: self.unfinished,
            }],
        };
        output::write_all(out, &experiment, drawn)?;
        match unfinished {
            0 => Ok(()),
            _ => Err(Failure::Unfinished(unfinished, all)),
        }
    }
}

/// All configs under which the recording is replayed.
fn settings(arguments: &Replay) -> Result<Vec<ReplayConfig>, Failure> {
    let base = arguments.options;
    let all_options = match &arguments.sweep {
        Some(sweep) => sweep.over(&base).map_err(Failure::Terms)?,
        None if arguments.matrix => sweep::matrix(&base).map_err(Failure::Terms)?,
        None => vec![base],
    };
    let mut without = arguments.without.clone();
    if arguments.no_fec {
        without.push(Feature::Fec);
    }
    let features = Feature::all_but(&without);
    let config = all_options.iter().map(|options| options.config(features));
    config.collect::<Result<_, _>>().map_err(Failure::Terms)
}
