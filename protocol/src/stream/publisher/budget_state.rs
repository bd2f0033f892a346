//! The state of a budget, and the bodies that wait for it.

use alloc::collections::BTreeMap;

use rhumb_reckoning::{BodyId, Tick};

use crate::stream::budget::TokenBucket;
use crate::stream::observation::Observation;

/// A waiting body's error counts double after this many ticks, triple after twice as many, and so on.
const AGE: f64 = 60.0;
/// The least weight of an error: for a sleeping body that only lacks its exact rest pose.
const ERROR_LEAST: f64 = 0.25;
/// One pick in this many goes to the body that waited longest, so that no body waits forever.
const PICKS_PER_LONGEST_WAITING: usize = 4;

/// The state of a budget.
#[derive(Debug)]
pub(super) struct BudgetState {
    pub(super) token_bucket: TokenBucket,
    /// Bodies that were due and have had no update since, by index.
    pub(super) waiting: BTreeMap<u32, WaitingBody>,
    /// The greatest share of a tolerance used by any track since the last packet, or at the ticks that it covers.
    pub(super) worst: f64,
    /// A packet was sent, so `worst` starts again at the next tick.
    pub(super) reported: bool,
    pub(super) pick_order: PickOrder,
}

/// A body whose update waits for the budget.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverBudget {
    /// The body.
    pub body: BodyId,
    /// The share of its tolerance that its track uses: above one if the body is out of tolerance.
    pub share: f64,
    /// The tick since which it waits.
    pub since: Tick,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct WaitingBody {
    pub(super) since: Tick,
    /// The share of its tolerance that its track used at the last published tick.
    pub(super) share: f64,
    /// The newest observation of the body.
    pub(super) observation: Observation,
    pub(super) observed_at: Tick,
}

/// A body that is due for an update.
#[derive(Clone, Copy, Debug)]
pub(super) struct DueUpdate {
    pub(super) observation: Observation,
    pub(super) share: f64,
    pub(super) since: Tick,
    /// Its track is about to become too old for a correction.
    pub(super) urgent: bool,
}

/// The rule by which a body is picked for an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pick {
    Worst,
    LongestWaiting,
}

/// The turn of the longest waiting body. The count continues from tick to tick, so it gets updates even if a tick
/// pays for few.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PickOrder {
    /// Picks since the last longest-waiting one, at most the interval.
    pub(super) since_longest_waiting: usize,
}

impl PickOrder {
    pub(super) const fn next(self) -> Pick {
        if self.since_longest_waiting < PICKS_PER_LONGEST_WAITING - 1 {
            Pick::Worst
        } else {
            Pick::LongestWaiting
        }
    }

    /// Counts a pick.
    pub(super) fn pass(&mut self, pick: Pick) {
        self.since_longest_waiting = match pick {
            Pick::Worst => (self.since_longest_waiting + 1).min(PICKS_PER_LONGEST_WAITING - 1),
            Pick::LongestWaiting => 0,
        };
    }
}

impl DueUpdate {
    pub(super) fn weight(&self, tick: Tick) -> f64 {
        let waited = tick.since(self.since).unwrap_or_default().count();
        self.share.max(ERROR_LEAST) * (1.0 + f64::from(waited) / AGE)
    }
}
