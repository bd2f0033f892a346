//! How a recording is replayed.
//!
//! Computes nothing: `stage` does as it says, and the record keeps it.

use std::num::NonZeroU32;

use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Metres, Ticks, Tolerance};
use rhumb_transport::LinkTerms;

use super::feature::{Feature, Means};
use crate::record::{Mode, Replayed, RunTerms};
use crate::recording::Recording;

/// How a recording is replayed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReplayTerms {
    /// What is promised.
    pub tolerance: Tolerance,
    /// Both ways.
    pub link: LinkTerms,
    /// Published every so many ticks.
    pub every: NonZeroU32,
    /// Of the link.
    pub seed: u64,
    /// How far the publisher looks back before it speaks.
    pub hindsight: Ticks,
    /// What is used.
    pub means: Means,
    /// What its packets may take, if that is limited.
    pub budget: Option<Budget>,
}

impl ReplayTerms {
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
            every: self.every.get(),
            hindsight_ticks: self.hindsight.count(),
            link_seed: self.seed,
            without: Feature::without(&self.means)
                .map(|feature| feature.name().to_owned())
                .collect(),
        }
    }

    /// How a replay of the recording was asked for.
    pub(super) fn run_terms(&self, recording: &Recording) -> RunTerms {
        let link = self.link;
        let is_pretended = link != LinkTerms::PERFECT;
        RunTerms {
            scene: recording.name.clone(),
            bodies: recording.bodies(),
            mode: Mode::Replay,
            depth: 0,
            tolerance_m: self.tolerance.length().map(Metres::metres),
            budget_bytes_per_second: self.budget.map(Budget::bytes_per_second),
            link: if is_pretended {
                link.to_string()
            } else {
                String::new()
            },
            seed: recording.played.map_or(self.seed, |played| played.seed),
            step_s: recording.integrator.rate.step().seconds(),
            ticks: recording.ticks(),
            followed: None,
            replayed: Some(self.replayed()),
            limit: None,
        }
    }
}
