//! Settings of a replay, their arguments, and features to switch off.
//!
//! `session` applies the settings, and the record keeps them.

use std::num::NonZeroU32;

use clap::{Args, ValueEnum};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::limits::{BUDGET_MAX, BUDGET_MIN};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::{Budget, Features, LOOKAHEAD_MAX};
use rhumb_reckoning::{Metres, Ticks, Tolerance};

use crate::record::{Mode, Replayed, RunConfig};
use crate::recording::{Recording, ToleranceOptions};

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

/// Settings of a replay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplayConfig {
    /// Tolerance of the copy.
    pub tolerance: Tolerance,
    /// Link, the same in both directions.
    pub link: LinkConfig,
    /// Ticks between publications.
    pub publish_interval: NonZeroU32,
    /// Seed of the link.
    pub seed: u64,
    /// Ticks by which the encoder looks ahead of the tick it codes.
    pub lookahead: Ticks,
    /// Enabled features.
    pub features: EnabledFeatures,
    /// Bandwidth limit of the stream, if any.
    pub budget: Option<Budget>,
    /// Largest packet of the stream.
    pub largest_packet: LargestPacket,
}

impl ReplayConfig {
    /// The settings in the form that the record keeps.
    fn replayed(&self) -> Replayed {
        let parts = match self.tolerance {
            Tolerance::Parts { position, turn } => {
                Some((position.metres().metres(), turn.radians().radians()))
            }
            Tolerance::Surface(_) => None,
        };
        Replayed {
            position_m: parts.map(|(position, _)| position),
            turn_rad: parts.map(|(_, turn)| turn),
            publish_interval: self.publish_interval.get(),
            lookahead_ticks: self.lookahead.count(),
            link_seed: self.seed,
            without: Feature::without(&self.features)
                .map(|feature| feature.name().to_owned())
                .collect(),
        }
    }

    /// The run config of a replay of `recording`.
    pub(super) fn run_config(&self, recording: &Recording) -> RunConfig {
        let link = self.link;
        let is_simulated = link != LinkConfig::PERFECT;
        RunConfig {
            scene: recording.name.clone(),
            bodies: recording.bodies(),
            mode: Mode::Replay,
            depth: 0,
            tolerance_m: self.tolerance.length().map(Metres::metres),
            budget_bytes_per_second: self.budget.map(Budget::bytes_per_second),
            link: if is_simulated {
                link.to_string()
            } else {
                String::new()
            },
            seed: recording.played.map_or(self.seed, |played| played.seed),
            step_s: recording.integrator.rate.step().seconds(),
            ticks: recording.ticks(),
            subscription: None,
            replayed: Some(self.replayed()),
            limit: None,
        }
    }
}

/// Features that a replay uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EnabledFeatures {
    /// Features of the publisher.
    pub publisher: Features,
    /// True if coded sizes are counted; if not, the sizes in plain codes are counted.
    pub coder: bool,
}

impl EnabledFeatures {
    /// All features.
    pub const ALL: Self = Self::of(Features::ALL);

    /// These publisher features, and the coder.
    #[must_use]
    pub const fn of(publisher: Features) -> Self {
        Self {
            publisher,
            coder: true,
        }
    }
}

/// A feature, as named on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Feature {
    /// Predict that a motionless awake body stays motionless.
    Resting,
    /// Predict ballistic motion.
    Ballistic,
    /// Predict torque-free rotation.
    TorqueFree,
    /// Attach bodies to parents.
    Attached,
    /// Derive velocities from corrections.
    Derived,
    /// Omit parts of corrections that the tolerance does not need.
    Sparse,
    /// Quantise velocities in coarser steps where that suffices.
    Coarse,
    /// Predict constant acceleration.
    ConstantAcceleration,
    /// Select corrections with lookahead (mode decision).
    ModeDecision,
    /// Encode motions as corrections of the prediction.
    Residuals,
    /// Send no update for a body within tolerance.
    Prefilter,
    /// Pack updates of several bodies into one packet.
    Packing,
    /// Entropy-code numbers; without it, only the counted sizes change, to those of plain codes.
    Coder,
    /// Send repair symbols for lost packets, unsolicited where loss is high.
    Fec,
    /// Send repair symbols without a request where loss is high.
    UnsolicitedFec,
    /// Split large ticks in two packets where loss is high.
    SplitTicks,
    /// Encode exact rest poses as corrections.
    RestCorrections,
    /// Name bodies by short aliases instead of their indices.
    Aliases,
    /// Send checksums over all tracks.
    Checksums,
}

impl Feature {
    /// All features, in the order of the list.
    pub const ALL: [Self; 19] = [
        Self::Resting,
        Self::Ballistic,
        Self::TorqueFree,
        Self::Attached,
        Self::Derived,
        Self::Sparse,
        Self::Coarse,
        Self::ConstantAcceleration,
        Self::ModeDecision,
        Self::Residuals,
        Self::Prefilter,
        Self::Packing,
        Self::Coder,
        Self::Fec,
        Self::UnsolicitedFec,
        Self::SplitTicks,
        Self::RestCorrections,
        Self::Aliases,
        Self::Checksums,
    ];

    /// Name on the command line and in the summary.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Resting => "resting",
            Self::Ballistic => "ballistic",
            Self::TorqueFree => "torque-free",
            Self::Attached => "attached",
            Self::Derived => "derived",
            Self::Sparse => "sparse",
            Self::Coarse => "coarse",
            Self::ConstantAcceleration => "constant-acceleration",
            Self::ModeDecision => "mode-decision",
            Self::Residuals => "residuals",
            Self::Prefilter => "prefilter",
            Self::Packing => "packing",
            Self::Coder => "coder",
            Self::Fec => "fec",
            Self::UnsolicitedFec => "unsolicited-fec",
            Self::SplitTicks => "split-ticks",
            Self::RestCorrections => "rest-corrections",
            Self::Aliases => "aliases",
            Self::Checksums => "checksums",
        }
    }

    /// All features except these.
    #[must_use]
    pub fn all_but(without: &[Self]) -> EnabledFeatures {
        let mut features = EnabledFeatures::ALL;
        for feature in without {
            *feature.switch(&mut features) = false;
        }
        features
    }

    /// The features that are switched off.
    pub fn without(features: &EnabledFeatures) -> impl Iterator<Item = Self> {
        let mut features = *features;
        Self::ALL
            .into_iter()
            .filter(move |feature| !*feature.switch(&mut features))
    }

    const fn switch(self, features: &mut EnabledFeatures) -> &mut bool {
        let publisher = &mut features.publisher;
        match self {
            Self::Resting => &mut publisher.resting,
            Self::Ballistic => &mut publisher.ballistic,
            Self::TorqueFree => &mut publisher.torque_free,
            Self::Attached => &mut publisher.attached,
            Self::Derived => &mut publisher.derived,
            Self::Sparse => &mut publisher.sparse,
            Self::Coarse => &mut publisher.coarse,
            Self::ConstantAcceleration => &mut publisher.accelerated,
            Self::ModeDecision => &mut publisher.mode_decision,
            Self::Residuals => &mut publisher.residuals,
            Self::Prefilter => &mut publisher.prefilter,
            Self::Packing => &mut publisher.packing,
            Self::Coder => &mut features.coder,
            Self::Fec => &mut publisher.redundancy,
            Self::UnsolicitedFec => &mut publisher.unsolicited,
            Self::SplitTicks => &mut publisher.halves,
            Self::RestCorrections => &mut publisher.rest_corrections,
            Self::Aliases => &mut publisher.aliases,
            Self::Checksums => &mut publisher.checksums,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_disabled_feature_is_listed_by_name() {
        assert_eq!(Feature::all_but(&[]), EnabledFeatures::ALL);
        for feature in Feature::ALL {
            let features = Feature::all_but(&[feature]);
            assert!(Feature::without(&features).eq([feature]));
            let value = feature.to_possible_value().expect("no value is hidden");
            assert_eq!(value.get_name(), feature.name());
        }
        assert_eq!(Feature::value_variants(), Feature::ALL);
    }
}
