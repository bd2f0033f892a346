//! How a recording is replayed.
//!
//! Computes nothing: `stage` does as it says, and the record keeps it.

use std::num::NonZeroU32;

use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Metres, Ticks, Tolerance};
use rhumb_transport::LinkConfig;

use super::feature::{EnabledFeatures, Feature};
use crate::record::{Mode, Replayed, RunConfig};
use crate::recording::Recording;

/// How a recording is replayed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplayConfig {
    /// What is promised.
    pub tolerance: Tolerance,
    /// Both ways.
    pub link: LinkConfig,
    /// Published every so many ticks.
    pub publish_interval: NonZeroU32,
    /// Of the link.
    pub seed: u64,
    /// How far the publisher looks back before it speaks.
    pub lookahead: Ticks,
    /// What is used.
    pub features: EnabledFeatures,
    /// What its packets may take, if that is limited.
    pub budget: Option<Budget>,
}

impl ReplayConfig {
    /// As a record tells of them.
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

    /// How a replay of the recording was asked for.
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
