//! The scan of observations: tracks out of tolerance and parent candidates.
//!
//! One pass over the observations. Bodies that surely hold cost nothing more. Changes no track. Invariant: positions in
//! `undecided` and `other_parents` rise.

use alloc::vec::Vec;

use rhumb_reckoning::{ErrorPrefilter, Tick};

use super::parent_candidates::ParentCandidates;
use super::published_tracks::PublishedTracks;
use crate::stream::features::Features;
use crate::stream::observation::{Activity, Observation};
use crate::stream::stream_config::StreamConfig;

/// The result of a scan, as positions among the observations. Its buffers are reused from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationScan {
    prefilter: ErrorPrefilter,
    /// Bodies whose tracks may not hold, in order.
    undecided: Vec<u32>,
    /// Those of them that the prefilter tested four at a time, in order, until they are merged into the others.
    tested: Vec<u32>,
    /// Undecided bodies with children that are no parent candidates, in order.
    other_parents: Vec<u32>,
    parent_candidates: ParentCandidates,
}

impl ObservationScan {
    pub(super) fn new(config: &StreamConfig) -> Self {
        Self {
            prefilter: ErrorPrefilter::new(config.tolerance, config.integrator),
            undecided: Vec::new(),
            tested: Vec::new(),
            other_parents: Vec::new(),
            parent_candidates: ParentCandidates::new(),
        }
    }

    /// Scans the observations of a tick.
    pub(super) fn scan(
        &mut self,
        published: &PublishedTracks,
        tick: Tick,
        observations: &[Observation],
        features: &Features,
    ) {
        self.undecided.clear();
        self.parent_candidates.clear();
        let tracks = published.tracks();
        let mut least = f64::INFINITY;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = published.observed(tick, observation) else {
                continue;
            };
            let radius = tracks.radius(slot).metres();
            least = least.min(radius);
            if features.attached && slot.parent().is_none() {
                self.parent_candidates.consider(radius, place);
            }
            let place = place as u32;
            if observation.activity == Activity::Asleep || !features.prefilter {
                self.undecided.push(place);
                continue;
            }
            let observed = (place, &observation.motion);
            let (prefilter, tested) = (&mut self.prefilter, &mut self.tested);
            if tracks.prefilter(slot, tick, observed, prefilter, tested) {
                self.undecided.push(place);
            }
        }
        self.prefilter.finish(&mut self.tested);
        self.merge_tested();
        self.parent_candidates.choose(least, observations);
    }

    /// Collects undecided bodies with children that are no parent candidates.
    pub(super) fn collect_other_parents(
        &mut self,
        published: &PublishedTracks,
        observations: &[Observation],
    ) {
        let other_parents = |place: &u32| {
            let place = *place as usize;
            published.has_children(observations[place].id.index())
                && !self.parent_candidates.contains(place)
        };
        self.other_parents.clear();
        self.other_parents
            .extend(self.undecided.iter().copied().filter(other_parents));
    }

    /// The parent candidates.
    pub(super) const fn parent_candidates(&self) -> &ParentCandidates {
        &self.parent_candidates
    }

    /// The same, to collect their observations.
    pub(super) const fn parent_candidates_mut(&mut self) -> &mut ParentCandidates {
        &mut self.parent_candidates
    }

    /// The positions of undecided bodies with children that are no parent candidates, in order.
    pub(super) fn other_parents(&self) -> impl Iterator<Item = usize> {
        self.other_parents.iter().map(|place| *place as usize)
    }

    /// The positions of the undecided bodies without those that are checked before: candidates and other parents.
    pub(super) fn others(&self) -> impl Iterator<Item = usize> {
        let others = self.undecided.iter().filter(|place| {
            !self.parent_candidates.contains(**place as usize)
                && self.other_parents.binary_search(place).is_err()
        });
        others.map(|place| *place as usize)
    }

    /// Merges the bodies that were tested four at a time into the others.
    fn merge_tested(&mut self) {
        let (mut others, mut tested) = (self.undecided.len(), self.tested.len());
        self.undecided.resize(others + tested, 0);
        // From the end on, so that each place is free before it is written.
        while tested > 0 {
            let last = others + tested - 1;
            if others > 0 && self.undecided[others - 1] > self.tested[tested - 1] {
                others -= 1;
                self.undecided[last] = self.undecided[others];
            } else {
                tested -= 1;
                self.undecided[last] = self.tested[tested];
            }
        }
        self.tested.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn merged_places_rise(places in proptest::collection::btree_map(0_u32..60, any::<bool>(), 0..40)) {
            let mut scan = ObservationScan::new(&StreamConfig::PLAIN);
            for (place, late) in &places {
                let to = if *late { &mut scan.tested } else { &mut scan.undecided };
                to.push(*place);
            }
            scan.merge_tested();
            prop_assert!(scan.undecided.iter().eq(places.keys()));
            prop_assert!(scan.tested.is_empty());
        }
    }
}
