//! Runs set beside how little would have done for what they promised.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use rhumb_reckoning::Tolerance;

use super::Limit;
use crate::record::{LimitRates, Run};
use crate::recording::Recording;

/// What is promised: a tolerance, at every so many ticks.
pub(crate) type Promised = (Tolerance, NonZeroU32);

/// Gives each run the limit of its promise, if it has one; what several promise is sought once.
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
    /// The figures that runs are set beside.
    #[must_use]
    pub fn rates(&self) -> LimitRates {
        LimitRates {
            updates_per_second: self.fewest_updates.updates_per_second,
            updates_on_grid_per_second: self.fewest_updates_on_grid.updates_per_second,
            kbps: self.fewest_bits.kbps,
        }
    }
}
