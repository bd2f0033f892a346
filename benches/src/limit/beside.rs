//! Adds to runs the limit for their tolerance.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use rhumb_reckoning::Tolerance;

use super::Limit;
use crate::record::{LimitRates, Run};
use crate::recording::Recording;

/// A tolerance and the publish interval at which it holds.
pub(crate) type Promised = (Tolerance, NonZeroU32);

/// Adds the limit to each run that states a tolerance; equal tolerances are computed once.
pub(crate) fn set_beside_limits<'a>(
    recording: &Recording,
    runs: impl Iterator<Item = (&'a mut Run, Option<Promised>)>,
) {
    let mut known = BTreeMap::new();
    for (run, promised) in runs {
        run.config.limit = promised.map(|(tolerance, publish_interval)| {
            let least = known.entry((tolerance, publish_interval));
            *least.or_insert_with(|| Limit::of(recording, tolerance, publish_interval).rates())
        });
    }
}

impl Limit {
    /// The figures to which runs are compared.
    #[must_use]
    pub fn rates(&self) -> LimitRates {
        LimitRates {
            updates_per_second: self.fewest_updates.updates_per_second,
            updates_on_grid_per_second: self.fewest_updates_on_grid.updates_per_second,
            kbps: self.fewest_bits.kbps,
        }
    }
}
