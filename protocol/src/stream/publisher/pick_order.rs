//! The order of due updates when a budget does not suffice for all.
//!
//! Urgent bodies first, then the worst. Every few picks one goes to the body that waited longest, so that no body waits
//! forever.

use alloc::vec::Vec;

use rhumb_reckoning::Tick;

use crate::stream::observation::Observation;

/// A waiting body's error counts double after this many ticks, triple after twice as many, and so on.
const AGE: f64 = 60.0;
/// The least weight of an error: for a sleeping body that only lacks its exact rest pose.
const ERROR_LEAST: f64 = 0.25;
/// One pick in this many goes to the body that waited longest, so that no body waits forever.
const PICKS_PER_LONGEST_WAITING: usize = 4;

/// A body that is due for an update.
#[derive(Clone, Copy, Debug)]
pub(super) struct DueUpdate {
    pub(super) observation: Observation,
    /// The share of its tolerance that its track uses.
    pub(super) share: f64,
    /// The tick since which it waits.
    pub(super) since: Tick,
    /// Its track is about to become too old for a correction.
    pub(super) urgent: bool,
}

impl DueUpdate {
    fn weight(&self, tick: Tick) -> f64 {
        let waited = tick.since(self.since).unwrap_or_default().count();
        self.share.max(ERROR_LEAST) * (1.0 + f64::from(waited) / AGE)
    }

    /// Lower for a body that is picked earlier: urgent ones first, then the heaviest.
    fn rank(&self, tick: Tick) -> u64 {
        // Positive doubles are in the order of their bits, and the highest bit, their sign, is free.
        let weight = self.weight(tick).to_bits();
        (u64::from(!self.urgent) << 63) + ((1 << 63) - 1 - weight)
    }
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
    since_longest_waiting: usize,
}

impl PickOrder {
    /// Counts a pick.
    pub(super) fn pass(&mut self, pick: Pick) {
        self.since_longest_waiting = match pick {
            Pick::Worst => (self.since_longest_waiting + 1).min(PICKS_PER_LONGEST_WAITING - 1),
            Pick::LongestWaiting => 0,
        };
    }

    /// The due updates in the order of picks, if all are picked from now on.
    pub(super) fn sorted(mut self, due: Vec<DueUpdate>, tick: Tick) -> Vec<(Pick, DueUpdate)> {
        let ranks = due.iter().map(|due| due.rank(tick));
        let mut ranked: Vec<(u64, usize)> = ranks.zip(0..).collect();
        ranked.sort_unstable();
        let due: Vec<DueUpdate> = ranked.into_iter().map(|(_, place)| due[place]).collect();
        let since = due.iter().map(|due| due.since.value());
        let mut eldest: Vec<(u64, usize)> = since.zip(0..).collect();
        eldest.sort_unstable();
        let mut taken = alloc::vec![false; due.len()];
        let mut order = Vec::with_capacity(due.len());
        let (mut worst, mut eldest) = (0..due.len(), eldest.into_iter().map(|(_, place)| place));
        while order.len() < due.len() {
            let is_free = |place: &usize| !taken[*place];
            let pick = self.next();
            let place = match pick {
                Pick::LongestWaiting => eldest.find(is_free),
                Pick::Worst => worst.find(is_free),
            };
            let Some(place) = place else { break };
            taken[place] = true;
            self.pass(pick);
            order.push((pick, due[place]));
        }
        order
    }

    const fn next(self) -> Pick {
        if self.since_longest_waiting < PICKS_PER_LONGEST_WAITING - 1 {
            Pick::Worst
        } else {
            Pick::LongestWaiting
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::observation::Activity;
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyId, BodyState};

    const NOW: Tick = Tick::new(100);

    fn due(index: usize, (share, since, urgent): (f64, u64, bool)) -> DueUpdate {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        DueUpdate {
            observation: Observation {
                id: BodyId::new(index as u32, 0),
                motion: still.expect("it is finite"),
                activity: Activity::Awake,
            },
            share,
            since: Tick::new(since),
            urgent,
        }
    }

    fn index((_, due): &(Pick, DueUpdate)) -> u32 {
        due.observation.id.index()
    }

    proptest! {
        #[test]
        fn every_due_body_is_picked_once_and_one_in_four_picks_waited_longest(
            bodies in proptest::collection::vec((0.0_f64..9.0, 0_u64..100, any::<bool>()), 0..50),
        ) {
            let due: Vec<_> = bodies.iter().enumerate().map(|(at, body)| due(at, *body)).collect();
            let order = PickOrder::default().sorted(due, NOW);
            let mut indices: Vec<u32> = order.iter().map(index).collect();
            for (at, (pick, picked)) in order.iter().enumerate() {
                let left = order[at..].iter().map(|(_, due)| due);
                match pick {
                    Pick::LongestWaiting => {
                        prop_assert_eq!(at % PICKS_PER_LONGEST_WAITING, PICKS_PER_LONGEST_WAITING - 1);
                        prop_assert!(left.clone().all(|other| picked.since <= other.since));
                    }
                    Pick::Worst => {
                        let rank = |due: &DueUpdate| (due.urgent, due.weight(NOW));
                        prop_assert!(left.clone().all(|other| rank(picked) >= rank(other)));
                    }
                }
            }
            indices.sort_unstable();
            prop_assert!(indices.into_iter().eq(0..bodies.len() as u32));
        }
    }
}
