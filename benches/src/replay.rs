//! `rhumb-bench replay`: publishes a recorded scene and subscribes to it.
//!
//! No engine steps and no socket opens: time is simulated, and one seed gives one result, bit exact. A sweep replays a
//! recording several times, with another value of one setting each time.

mod config;
mod session;

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

use clap::Args;
use rhumb_netsim::LinkConfig;

use crate::limit::{Promised, set_beside_limits};
use crate::machine;
use crate::output::{self, Failure, ended};
use crate::record::{Experiment, Load, Run, Unfinished};
use crate::recording::{Recording, RecordingSource};

pub(crate) use self::config::budget;
pub use self::config::{EnabledFeatures, Feature, ReplayConfig, ReplayOptions};
pub(crate) use self::session::tally;
pub use self::session::{ReplayError, run};

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
        Some(error) if replays.ended.is_empty() => Err(match all.len() {
            1 => error.into(),
            count => format!("all {count} replays failed; the first: {error}").into(),
        }),
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
            _ => Err(format!(
                "{unfinished} of {all} replays failed, see the table; the results of the others are written"
            )
            .into()),
        }
    }
}

/// All configs under which the recording is replayed.
fn settings(arguments: &Replay) -> Result<Vec<ReplayConfig>, Failure> {
    let base = arguments.options;
    let all_options = match &arguments.sweep {
        Some(sweep) => sweep.over(&base)?,
        None if arguments.matrix => matrix(&base)?,
        None => vec![base],
    };
    let mut without = arguments.without.clone();
    if arguments.no_fec {
        without.push(Feature::Fec);
    }
    let features = Feature::all_but(&without);
    let config = all_options.iter().map(|options| options.config(features));
    Ok(config.collect::<Result<_, _>>()?)
}

/// A setting's name and its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    name: String,
    values: Vec<String>,
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, values) = text.split_once('=').ok_or("must be name=value,value,...")?;
        let values: Vec<_> = values.split(',').map(|v| v.trim().to_owned()).collect();
        if values.iter().any(String::is_empty) {
            return Err("a value is missing".to_owned());
        }
        let name = name.trim().to_owned();
        Ok(Self { name, values })
    }
}

impl Sweep {
    /// The options for each value.
    pub(super) fn over(&self, base: &ReplayOptions) -> Result<Vec<ReplayOptions>, String> {
        let with = |value: &String| change(base, &self.name, value);
        self.values.iter().map(with).collect()
    }
}

/// The options with one setting changed.
fn change(base: &ReplayOptions, name: &str, value: &str) -> Result<ReplayOptions, String> {
    let mut options = *base;
    let wrong = || format!("{name}={value}: not a number");
    match name {
        "tolerance" => options.tolerance_options.tolerance = value.parse().map_err(|_| wrong())?,
        "turn" => options.tolerance_options.turn = Some(value.parse().map_err(|_| wrong())?),
        "publish-interval" => options.publish_interval = value.parse().map_err(|_| wrong())?,
        "seed" => options.seed = value.parse().map_err(|_| wrong())?,
        "budget" if value == "none" => options.budget = None,
        "budget" => {
            let read = budget(value);
            options.budget = Some(read.map_err(|why| format!("budget={value}: {why}"))?);
        }
        _ => options.link = with_link(base.link, &format!("{name}={value}"))?,
    }
    Ok(options)
}

/// The link with some parts changed.
fn with_link(link: LinkConfig, parts: &str) -> Result<LinkConfig, String> {
    let text = format!("{link},{parts}");
    text.parse()
        .map_err(|error: rhumb_netsim::LinkConfigError| error.to_string())
}

/// Losses in percent, even and in bursts of four, at each round trip; zero loss has no bursts.
pub(super) fn matrix(base: &ReplayOptions) -> Result<Vec<ReplayOptions>, String> {
    let mut all = Vec::new();
    for rtt_ms in [0, 50, 100, 300] {
        for (loss, burst) in [(0, 1), (1, 1), (5, 1), (20, 1), (1, 4), (5, 4), (20, 4)] {
            let parts = format!("rtt={rtt_ms}ms,loss={loss}%,burst={burst}");
            let link = with_link(base.link, &parts)?;
            all.push(ReplayOptions { link, ..*base });
        }
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;

    use rhumb_protocol::packet::LargestPacket;

    use super::*;
    use crate::recording::ToleranceOptions;

    fn base() -> ReplayOptions {
        ReplayOptions {
            tolerance_options: ToleranceOptions {
                tolerance: 0.01,
                turn: None,
            },
            link: "jitter=3ms".parse().unwrap(),
            publish_interval: NonZeroU32::MIN,
            seed: 1,
            lookahead: 0,
            budget: None,
            largest_packet: LargestPacket::DEFAULT,
        }
    }

    #[test]
    fn a_sweep_changes_one_setting_and_keeps_the_others() {
        let sweep: Sweep = "loss=1%,5%".parse().unwrap();
        let all = sweep.over(&base()).unwrap();
        let links: Vec<_> = all.iter().map(|options| options.link).collect();
        let expected = ["jitter=3ms,loss=1%", "jitter=3ms,loss=5%"].map(|t| t.parse().unwrap());
        assert_eq!(links, expected);
        let sweep: Sweep = "tolerance=0.02".parse().unwrap();
        assert!((sweep.over(&base()).unwrap()[0].tolerance_options.tolerance - 0.02).abs() < 1e-12);
        let sweep: Sweep = "budget=none,4000".parse().unwrap();
        let budgets = sweep
            .over(&base())
            .unwrap()
            .into_iter()
            .map(|options| options.budget);
        assert!(budgets.eq([None, rhumb_protocol::stream::Budget::per_second(4_000)]));
        let sweep: Sweep = "seed=1,12".parse().unwrap();
        let seeds = sweep.over(&base()).unwrap().into_iter();
        assert!(seeds.map(|options| options.seed).eq([1, 12]));
        assert_eq!(matrix(&base()).unwrap().len(), 28);
    }

    #[test]
    fn an_unknown_setting_is_refused() {
        assert!("tolerance".parse::<Sweep>().is_err());
        assert!("tolerance=1,".parse::<Sweep>().is_err());
        for wrong in [
            "tolerance=x",
            "publish-interval=0",
            "seed=-1",
            "budget=9",
            "colour=red",
        ] {
            let sweep: Sweep = wrong.parse().unwrap();
            assert!(sweep.over(&base()).is_err(), "{wrong}");
        }
    }
}
