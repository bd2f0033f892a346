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
            parent_candidates: Vec::new(),
            observed_parents: Vec::new(),
            other_parents: Vec::new(),
            largest: Vec::with_capacity(PARENT_CANDIDATES_MAX + 1),
        }
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
