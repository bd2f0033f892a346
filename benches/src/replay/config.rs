//! Settings of a replay.
//!
//! Contains no logic: `session` applies the settings, and the record keeps them.

use std::num::NonZeroU32;

use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Metres, Ticks, Tolerance};

use super::feature::{EnabledFeatures, Feature};
use crate::record::{Mode, Replayed, RunConfig};
use crate::recording::Recording;

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
