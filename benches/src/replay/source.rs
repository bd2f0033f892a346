//! Arguments common to all tasks on a recording.
//!
//! They select the recording and the settings of publishing and subscribing.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use clap::Args;
use rhumb_netsim::LinkConfig;
use rhumb_protocol::limits::{BUDGET_MAX, BUDGET_MIN};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::{Budget, LOOKAHEAD_MAX};
use rhumb_reckoning::{Damping, Metres, Radians, Ticks, Tolerance};

use super::config::ReplayConfig;
use super::failure::Failure;
use super::feature::EnabledFeatures;
use crate::output;
use crate::recording::{self, Recording, RecordingError};

/// The recording and the parameters of its engine.
#[derive(Clone, Debug, Args)]
pub struct RecordingSource {
    /// The recording: a trace.mcap or an .rhtrace.zst.
    trace: PathBuf,
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
        let mut recording = recording::read(&self.trace)?;
        recording.damping = self.damping.unwrap_or(recording.damping);
        recording.integrator.substeps = self.substeps.unwrap_or(recording.integrator.substeps);
        Ok(recording)
    }
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

/// Arguments of the tolerance.
#[derive(Clone, Copy, Debug, Args)]
pub struct ToleranceOptions {
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value = "0.01", allow_negative_numbers = true)]
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
    /// The link, such as rtt=100ms,loss=5%,jitter=10ms, in simulated time.
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
