//! What every task on a recording is asked for alike.
//!
//! Which recording, and under which config it is published and followed.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use clap::Args;
use rhumb_protocol::limits::{BUDGET_MAX, BUDGET_MIN};
use rhumb_protocol::stream::{Budget, LOOKAHEAD_MAX};
use rhumb_reckoning::{Damping, Metres, Radians, Ticks, Tolerance};
use rhumb_transport::LinkConfig;

use super::config::ReplayConfig;
use super::failure::Failure;
use super::feature::EnabledFeatures;
use crate::output;
use crate::recording::{Recording, RecordingError};

/// Which recording, and how its engine stepped.
#[derive(Clone, Debug, Args)]
pub struct RecordingSource {
    /// The recording: a trace.mcap of ours, or an .rhtrace.zst.
    trace: PathBuf,
    /// Linear and angular damping of the recorded bodies, 1/s, if they are not those of the recording's scene.
    #[arg(long, value_parser = damping)]
    damping: Option<Damping>,
    /// Substeps of the recorded engine, if they are not those of the recording's scene.
    #[arg(long)]
    substeps: Option<NonZeroU32>,
}

impl RecordingSource {
    /// Refuses a folder whose `trace.mcap` is the recording: what is written there would take its place.
    pub(super) fn refuse_overwriting(&self, out: &Path) -> Result<(), Failure> {
        let real = |path: &Path| path.canonicalize().ok();
        let own = real(&self.trace);
        if own.is_some() && own == real(&output::trace_of(out)) {
            return Err(Failure::Terms(format!(
                "the trace of this replay would take the place of {}: name another folder by --out, or say --no-trace",
                self.trace.display()
            )));
        }
        Ok(())
    }

    pub(crate) fn read(&self) -> Result<Recording, RecordingError> {
        let mut recording = Recording::read(&self.trace)?;
        recording.damping = self.damping.unwrap_or(recording.damping);
        recording.integrator.substeps = self.substeps.unwrap_or(recording.integrator.substeps);
        Ok(recording)
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

/// The promise that is made.
#[derive(Clone, Copy, Debug, Args)]
pub struct ToleranceOptions {
    /// How far off a copied body may be, metres.
    #[arg(long, default_value = "0.01", allow_negative_numbers = true)]
    pub(super) tolerance: f64,
    /// How far it may be turned, degrees; the tolerance is then one of its centre alone.
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

/// How it is published and followed.
#[derive(Clone, Copy, Debug, Args)]
pub struct ReplayOptions {
    #[command(flatten)]
    pub(super) tolerance_options: ToleranceOptions,
    /// The link, such as rtt=100ms,loss=5%,jitter=10ms, in simulated time.
    #[arg(long, default_value_t = LinkConfig::PERFECT)]
    pub(super) link: LinkConfig,
    /// Publish every so many ticks of the recording.
    #[arg(long, default_value = "1")]
    pub(super) publish_interval: NonZeroU32,
    /// Seed of the simulated link.
    #[arg(long, default_value_t = 1)]
    pub(super) seed: u64,
    /// Ticks that the publisher looks back before it speaks of one; the copy is as much later.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=i64::from(LOOKAHEAD_MAX.count())))]
    pub(super) lookahead: u32,
    /// Bytes a second that the stream's packets may take; without one they take what the promise needs.
    #[arg(long, value_name = "BYTES/S", value_parser = budget)]
    pub(super) budget: Option<Budget>,
}

/// Bytes a second, of which a quarter may be said at once.
pub(crate) fn budget(text: &str) -> Result<Budget, String> {
    let budget = text.parse().ok().and_then(Budget::per_second);
    budget.ok_or_else(|| format!("must be bytes a second, from {BUDGET_MIN} to {BUDGET_MAX}"))
}

impl ReplayOptions {
    pub(crate) const fn seed(&self) -> u64 {
        self.seed
    }

    /// The config of a replay with these means.
    pub(crate) fn config(&self, features: EnabledFeatures) -> Result<ReplayConfig, String> {
        Ok(ReplayConfig {
            tolerance: self.tolerance_options.tolerance()?,
            link: self.link,
            publish_interval: self.publish_interval,
            seed: self.seed,
            lookahead: Ticks::new(self.lookahead),
            budget: self.budget,
            features,
        })
    }
}
