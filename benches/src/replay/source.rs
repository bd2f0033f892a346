//! Arguments and errors common to all tasks on a recording.
//!
//! The arguments select the recording and the settings of publishing and subscribing.

use std::io::Write;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::{fmt, io};

use clap::Args;
use glam::Vec3;
use rhumb_netsim::LinkConfig;
use rhumb_protocol::limits::{BUDGET_MAX, BUDGET_MIN};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::{Budget, LOOKAHEAD_MAX};
use rhumb_reckoning::{Damping, Metres, Radians, Rate, Ticks, Tolerance};

use super::config::{EnabledFeatures, ReplayConfig};
use super::session::ReplayError;
use crate::output::OutputError;
use crate::recording::{MissingPoses, ReadOptions, Recording, RecordingError, ShapeChoice};
use crate::{output, recording};

/// The recording and the parameters of its engine.
#[derive(Clone, Debug, Args)]
pub struct RecordingSource {
    /// The recording: a trace.mcap, a recording of a server, poses of bodies in MCAP or CSV, or an .rhtrace.zst.
    trace: PathBuf,
    /// The load of a trace such as n500, the scene of a recording, or transforms, poses or scene of another program's
    /// file [default: the file's first].
    #[arg(long, value_name = "NAME")]
    load: Option<String>,
    /// Poses: their rate in hertz, such as 29.97 [default: found from the times].
    #[arg(long, value_name = "HZ", value_parser = recording::hertz)]
    rate: Option<Rate>,
    /// Poses: gravity in their frame, m/s² [default: none].
    #[arg(long, value_name = "X,Y,Z", value_parser = gravity, allow_hyphen_values = true)]
    gravity: Option<Vec3>,
    /// Poses: shape of all bodies, or of one, such as cuboid:0.2,0.1,0.3 or arm=capsule:0.5,0.1; may be repeated
    /// [default: ball:0.1].
    #[arg(long, value_name = "SHAPE")]
    shape: Vec<ShapeChoice>,
    /// Poses: what it means that a body has none in a frame.
    #[arg(long, value_enum, default_value = "gone")]
    missing: MissingPoses,
    /// Linear and angular damping of the recorded bodies, 1/s, if they differ from the recording's scene.
    #[arg(long, value_parser = damping)]
    damping: Option<Damping>,
    /// Substeps of the recorded engine, if they differ from the recording's scene.
    #[arg(long)]
    substeps: Option<NonZeroU32>,
}

impl RecordingSource {
    /// Refuses an output folder whose `trace.mcap` is the recording itself.
    pub(super) fn refuse_overwriting(&self, out: &Path) -> Result<(), Failure> {
        let real = |path: &Path| path.canonicalize().ok();
        let own = real(&self.trace);
        if own.is_some() && own == real(&output::trace_of(out)) {
            return Err(Failure::Terms(format!(
                "the trace of this replay would overwrite {}: choose another folder by --out, or use --no-trace",
                self.trace.display()
            )));
        }
        Ok(())
    }

    pub(crate) fn read(&self) -> Result<Recording, RecordingError> {
        let options = ReadOptions {
            load: self.load.clone(),
            rate: self.rate,
            gravity: self.gravity,
            shapes: self.shape.clone(),
            missing: self.missing,
        };
        let mut recording = recording::read(&self.trace, &options)?;
        print_notes(&recording);
        recording.damping = self.damping.unwrap_or(recording.damping);
        recording.integrator.substeps = self.substeps.unwrap_or(recording.integrator.substeps);
        Ok(recording)
    }
}

/// Prints the facts that a file lacks to standard error.
pub(crate) fn print_notes(recording: &Recording) {
    for note in &recording.notes {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "note: {}: {note}", recording.name);
    }
}

/// Parses `0,-9.81,0`.
fn gravity(text: &str) -> Result<Vec3, String> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    let gravity = match numbers.as_deref() {
        Ok(&[x, y, z]) => Some(Vec3::new(x, y, z)),
        _ => None,
    };
    let gravity = gravity.filter(|gravity| gravity.is_finite());
    gravity.ok_or_else(|| "must be three numbers, x,y,z".to_owned())
}

/// Parses `0.1,0.05`.
fn damping(text: &str) -> Result<Damping, String> {
    let (linear, angular) = text
        .split_once(',')
        .ok_or("must be two numbers, linear,angular")?;
    let read = |text: &str| {
        let value = text.trim().parse::<f32>().ok();
        value.filter(|value| (0.0..=1_000.0).contains(value))
    };
    let pair = read(linear).zip(read(angular));
    let (linear, angular) = pair.ok_or("must be two numbers from 0 to 1000")?;
    Ok(Damping { linear, angular })
}

/// Tolerance of every task that is given none, metres.
pub(crate) const DEFAULT_TOLERANCE: &str = "0.05";

/// Arguments of the tolerance.
#[derive(Clone, Copy, Debug, Args)]
pub struct ToleranceOptions {
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value = DEFAULT_TOLERANCE, allow_negative_numbers = true)]
    pub(super) tolerance: f64,
    /// Tolerance of its rotation, degrees; --tolerance then bounds its position alone.
    #[arg(long, allow_negative_numbers = true)]
    pub(super) turn: Option<f64>,
}

impl ToleranceOptions {
    pub(crate) fn tolerance(&self) -> Result<Tolerance, String> {
        let metres = Metres::new(self.tolerance);
        let read = match self.turn {
            Some(degrees) => Tolerance::parts(metres, Radians::new(degrees.to_radians())),
            None => Tolerance::from_metres(metres),
        };
        read.map_err(|error| error.to_string())
    }
}

/// Settings of publishing and subscribing.
#[derive(Clone, Copy, Debug, Args)]
pub struct ReplayOptions {
    #[command(flatten)]
    pub(super) tolerance_options: ToleranceOptions,
    /// The link in simulated time, such as rtt=100ms,loss=5%,jitter=10ms. Its parts: rtt or delay (of one way), jitter,
    /// loss, burst (mean run of losses, packets), dup, reorder, rate (as 1mbit), queue (as 64kB).
    #[arg(long, default_value_t = LinkConfig::PERFECT)]
    pub(super) link: LinkConfig,
    /// Ticks between publications.
    #[arg(long, default_value = "1")]
    pub(super) publish_interval: NonZeroU32,
    /// Seed of the simulated link.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Ticks by which the encoder looks ahead; the copy lags by as many.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=i64::from(LOOKAHEAD_MAX.count())))]
    pub(super) lookahead: u32,
    /// Bandwidth limit of the stream, bytes per second; unlimited by default.
    #[arg(long, value_name = "BYTES/S", value_parser = budget)]
    pub(super) budget: Option<Budget>,
    /// Largest packet of the stream, bytes, from 700 to 1150.
    #[arg(long, value_name = "BYTES", default_value_t)]
    pub(super) largest_packet: LargestPacket,
}

/// Parses a budget in bytes per second; a quarter of it may be sent at once.
pub(crate) fn budget(text: &str) -> Result<Budget, String> {
    let budget = text.parse().ok().and_then(Budget::per_second);
    budget.ok_or_else(|| format!("must be bytes per second, from {BUDGET_MIN} to {BUDGET_MAX}"))
}

impl ReplayOptions {
    pub(crate) const fn seed(&self) -> u64 {
        self.seed
    }

    /// The config of a replay with these features.
    pub(crate) fn config(&self, features: EnabledFeatures) -> Result<ReplayConfig, String> {
        Ok(ReplayConfig {
            tolerance: self.tolerance_options.tolerance()?,
            link: self.link,
            publish_interval: self.publish_interval,
            seed: self.seed,
            lookahead: Ticks::new(self.lookahead),
            budget: self.budget,
            largest_packet: self.largest_packet,
            features,
        })
    }
}

/// The error of a task on a recording.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The recording cannot be read.
    Recording(RecordingError),
    /// All of this many replays failed; the first one's error.
    Replay(usize, ReplayError),
    /// Number of failed replays and of all replays; the results of the others are written.
    Unfinished(usize, usize),
    /// An output cannot be written.
    Output(OutputError),
    /// Invalid arguments, as text.
    Terms(String),
}

/// Exit code 0 on success; otherwise prints the failure to standard error and returns 1.
pub(crate) fn ended(result: Result<(), Failure>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {failure}");
            ExitCode::FAILURE
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Recording(cause) => cause.fmt(f),
            Self::Replay(1, cause) => cause.fmt(f),
            Self::Replay(all, cause) => {
                write!(f, "all {all} replays failed; the first: {cause}")
            }
            Self::Unfinished(unfinished, all) => write!(
                f,
                "{unfinished} of {all} replays failed, see the table; the results of the others are written"
            ),
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

impl From<OutputError> for Failure {
    fn from(cause: OutputError) -> Self {
        Self::Output(cause)
    }
}
