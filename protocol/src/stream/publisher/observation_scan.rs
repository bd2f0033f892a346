//! The result of a scan of the observations.

use alloc::vec::Vec;

use rhumb_reckoning::{ErrorPrefilter, Integrator, Tolerance};

use super::large_body::{LargeBody, ObservedParent, PARENT_CANDIDATES_MAX};

/// The result of a scan, as positions among the observations. Its buffers are reused from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationScan {
    pub(super) prefilter: ErrorPrefilter,
    /// Bodies whose tracks may not hold, in order.
    pub(super) undecided: Vec<u32>,
    /// Those of them that the prefilter tested four at a time, in order, until they are merged into the others.
    pub(super) tested: Vec<u32>,
    /// Parent candidates, the largest first.
    pub(super) parent_candidates: Vec<LargeBody>,
    /// The same bodies with their observations.
    pub(super) observed_parents: Vec<ObservedParent>,
    /// Undecided bodies with children that are no parent candidates, in order.
    pub(super) other_parents: Vec<u32>,
    /// The largest bodies so far, with their radii.
    pub(super) largest: Vec<(f64, usize)>,
}

impl ObservationScan {
    pub(super) fn new(tolerance: Tolerance, integrator: Integrator) -> Self {
        Self {
            prefilter: ErrorPrefilter::new(tolerance, integrator),
            undecided: Vec::new(),
            tested: Vec::new(),
            parent_candidates: Vec::new(),
            observed_parents: Vec::new(),
            other_parents: Vec::new(),
            largest: Vec::with_capacity(PARENT_CANDIDATES_MAX + 1),
        }
    }

    /// Merges the bodies that were tested four at a time into the others.
    pub(super) fn merge_tested(&mut self) {
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

    /// True if a body is checked before bodies that could be attached.
    pub(super) fn is_before(&self, place: u32) -> bool {
        let holds = |parent_candidate: &LargeBody| parent_candidate.place == place as usize;
        self.parent_candidates.iter().any(holds) || self.other_parents.binary_search(&place).is_ok()
    }

    /// Keeps the largest moving bodies that are not attached.
    pub(super) fn consider(&mut self, radius: f64, place: usize) {
        let full = self.largest.len() == PARENT_CANDIDATES_MAX;
        if full && self.largest[PARENT_CANDIDATES_MAX - 1].0 >= radius {
            return;
        }
        let at = self.largest.partition_point(|(other, _)| *other >= radius);
        self.largest.insert(at, (radius, place));
        self.largest.truncate(PARENT_CANDIDATES_MAX);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::num::NonZeroU32;
    use proptest::prelude::*;
    use rhumb_reckoning::Rate;

    proptest! {
        #[test]
        fn merged_places_rise(places in proptest::collection::btree_map(0_u32..60, any::<bool>(), 0..40)) {
            let integrator = Integrator { rate: Rate::HZ_60, substeps: NonZeroU32::MIN };
            let mut scan = ObservationScan::new(Tolerance::NORMAL, integrator);
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
