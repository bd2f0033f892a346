//! `rhumb-bench replay`: publishes a recorded scene and follows it.
//!
//! Nothing is stepped and no socket is opened: time is simulated, and one seed gives one result, to the bit.

mod judge;
mod listener;
mod stage;
mod sweep;

use std::fmt;
use std::io::{self, Write};
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use rhumb_protocol::stream::{Features, HINDSIGHT_MAX};
use rhumb_reckoning::{Damping, Metres, Radians, Ticks, Tolerance};
use rhumb_transport::LinkTerms;

use crate::machine;
use crate::output::{self, OutputError};
use crate::record::{Experiment, Load};
use crate::recording::{Recording, RecordingError};

pub use stage::{ReplayError, ReplayTerms, run};
pub use sweep::Sweep;

/// Which recording to replay, how, and where to write what came of it.
#[derive(Clone, Debug, Args)]
pub struct Replay {
    /// The recording: a trace.mcap of ours, or an .rhtrace.zst.
    trace: PathBuf,
    /// How far off a copied body may be, metres.
    #[arg(long, default_value = "0.01", allow_negative_numbers = true)]
    tolerance: f64,
    /// How far it may be turned, degrees; the tolerance is then one of its centre alone.
    #[arg(long, allow_negative_numbers = true)]
    turn: Option<f64>,
    /// The link, such as rtt=100ms,loss=5%,jitter=10ms, in simulated time.
    #[arg(long, default_value_t = LinkTerms::PERFECT)]
    link: LinkTerms,
    /// Publish every so many ticks of the recording.
    #[arg(long, default_value = "1")]
    every: NonZeroU32,
    /// Seed of the pretended link.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Ticks that the publisher looks back before it speaks of one; the copy is as much later.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=i64::from(HINDSIGHT_MAX.count())))]
    hindsight: u32,
    /// Switch these means of the publisher off.
    #[arg(long, value_delimiter = ',')]
    without: Vec<Feature>,
    /// Linear and angular damping of the recorded bodies, 1/s, if they are not those of the recording's scene.
    #[arg(long, value_parser = damping)]
    damping: Option<Damping>,
    /// Substeps of the recorded engine, if they are not those of the recording's scene.
    #[arg(long)]
    substeps: Option<NonZeroU32>,
    /// Replay once for each value, such as tolerance=0.005,0.01,0.02 or loss=0%,1%,5%; others: turn, every, and the
    /// names of a link.
    #[arg(long, conflicts_with = "matrix")]
    sweep: Option<Sweep>,
    /// Replay once for each loss of 0, 1, 5 and 20 %, even and in bursts of 4, at round trips of 0, 50, 100 and 300 ms.
    #[arg(long)]
    matrix: bool,
    /// Folder for summary.json, report.html, trace.mcap and its layout; made if it is not there.
    #[arg(long, default_value = "results")]
    out: PathBuf,
    /// Write no trace.
    #[arg(long)]
    no_trace: bool,
}

/// A means of the publisher, as it is named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Feature {
    /// Predicting that what falls goes on falling.
    Ballistic,
    /// Predicting that what tumbles goes on tumbling.
    Tumbling,
    /// Letting bodies be held by others.
    Held,
    /// Leaving velocities to be implied.
    Derived,
    /// Leaving out of corrections what the tolerance does not need.
    Sparse,
    /// Saying motions as corrections.
    Residuals,
    /// Not speaking of what is within tolerance.
    Gate,
}

fn features(without: &[Feature]) -> Features {
    let has = |feature| !without.contains(&feature);
    Features {
        ballistic: has(Feature::Ballistic),
        tumbling: has(Feature::Tumbling),
        held: has(Feature::Held),
        derived: has(Feature::Derived),
        sparse: has(Feature::Sparse),
        residuals: has(Feature::Residuals),
        gate: has(Feature::Gate),
    }
}

/// `0.1,0.05`.
fn damping(text: &str) -> Result<Damping, String> {
    let (linear, angular) = text
        .split_once(',')
        .ok_or("needs two numbers, linear,angular")?;
    let read = |text: &str| {
        let value = text.trim().parse::<f32>().ok();
        value.filter(|value| (0.0..=1_000.0).contains(value))
    };
    let pair = read(linear).zip(read(angular));
    let (linear, angular) = pair.ok_or("must be two numbers from 0 to 1000")?;
    Ok(Damping { linear, angular })
}

/// Why a replay did not come to its end.
#[derive(Debug)]
enum Failure {
    Recording(RecordingError),
    Replay(ReplayError),
    Output(OutputError),
    Terms(String),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recording(cause) => cause.fmt(f),
            Self::Replay(cause) => cause.fmt(f),
            Self::Output(cause) => cause.fmt(f),
            Self::Terms(cause) => f.write_str(cause),
        }
    }
}

impl From<RecordingError> for Failure {
    fn from(cause: RecordingError) -> Self {
        Self::Recording(cause)
    }
}

impl From<ReplayError> for Failure {
    fn from(cause: ReplayError) -> Self {
        Self::Replay(cause)
    }
}

impl From<OutputError> for Failure {
    fn from(cause: OutputError) -> Self {
        Self::Output(cause)
    }
}

/// Replays. Exit code 0 when everything was replayed and written, 1 otherwise.
pub fn replay(arguments: &Replay) -> ExitCode {
    match replay_all(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // Nowhere is left to say that standard error is closed.
            let _ = writeln!(io::stderr(), "error: {failure}");
            ExitCode::FAILURE
        }
    }
}

fn replay_all(arguments: &Replay) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let all = settings(arguments)?;
    let mut recording = Recording::read(&arguments.trace)?;
    recording.damping = arguments.damping.unwrap_or(recording.damping);
    recording.integrator.substeps = arguments.substeps.unwrap_or(recording.integrator.substeps);
    let mut runs = Vec::new();
    for (number, terms) in all.iter().enumerate() {
        let what = format!("replay {} of {}", number + 1, all.len());
        let bar = output::progress_bar(u64::from(recording.ticks()), what);
        runs.push(run(&recording, terms, &mut |_| bar.inc(1))?);
        bar.finish_and_clear();
    }
    let bodies = recording.bodies();
    let experiment = Experiment {
        command: output::command_line(),
        seed: arguments.seed,
        machine: machine::describe(),
        loads: vec![Load {
            truth: recording.truth,
            runs,
        }],
    };
    let drawn = (!arguments.no_trace).then_some(bodies);
    output::write_all(&arguments.out, &experiment, drawn)?;
    Ok(())
}

/// Each way in which the recording is to be replayed.
fn settings(arguments: &Replay) -> Result<Vec<ReplayTerms>, Failure> {
    let of = |setting: &sweep::Setting| {
        let tolerance = tolerance(setting.tolerance, setting.turn).map_err(Failure::Terms)?;
        if arguments.hindsight > 0 && setting.every.get() > 1 {
            let text = "--hindsight looks at every tick: leave --every at 1".to_owned();
            return Err(Failure::Terms(text));
        }
        Ok(ReplayTerms {
            tolerance,
            link: setting.link,
            every: setting.every,
            seed: arguments.seed,
            hindsight: Ticks::new(arguments.hindsight),
            features: features(&arguments.without),
        })
    };
    let base = sweep::Setting {
        tolerance: arguments.tolerance,
        turn: arguments.turn,
        link: arguments.link,
        every: arguments.every,
    };
    let settings = match &arguments.sweep {
        Some(sweep) => sweep.over(&base).map_err(Failure::Terms)?,
        None if arguments.matrix => sweep::matrix(&base).map_err(Failure::Terms)?,
        None => vec![base],
    };
    settings.iter().map(of).collect()
}

fn tolerance(metres: f64, degrees: Option<f64>) -> Result<Tolerance, String> {
    let metres = Metres::new(metres);
    let read = match degrees {
        Some(degrees) => Tolerance::parts(metres, Radians::new(degrees.to_radians())),
        None => Tolerance::from_metres(metres),
    };
    read.map_err(|error| error.to_string())
}
