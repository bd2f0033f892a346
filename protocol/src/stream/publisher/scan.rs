//! The scan of observations: tracks out of tolerance and parent candidates.
//!
//! One pass over the observations. Bodies that surely hold cost nothing more. Changes no track.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{ErrorPrefilter, Integrator, Tick, Tolerance};

use super::Publisher;
use super::attaching::{LargeBody, PARENT_CANDIDATES_MAX, PARENT_SIZE_RATIO};
use crate::stream::observation::{Activity, Observation};

/// The result of a scan, as positions among the observations. Its buffers are reused from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationScan {
    prefilter: ErrorPrefilter,
    /// Bodies whose tracks may not hold, in order.
    pub(super) undecided: Vec<u32>,
    /// Parent candidates, the largest first.
    pub(super) parent_candidates: Vec<LargeBody>,
    /// Undecided bodies with children that are no parent candidates, in order.
    pub(super) other_parents: Vec<u32>,
    /// The largest bodies so far, with their radii.
    largest: Vec<(f64, usize)>,
}

impl ObservationScan {
    pub(super) fn new(tolerance: Tolerance, integrator: Integrator) -> Self {
        Self {
            prefilter: ErrorPrefilter::new(tolerance, integrator),
            undecided: Vec::new(),
            parent_candidates: Vec::new(),
            other_parents: Vec::new(),
            largest: Vec::with_capacity(PARENT_CANDIDATES_MAX + 1),
        }
    }

    /// Whether a body is checked before bodies that could be attached.
    pub(super) fn is_before(&self, place: u32) -> bool {
        let holds = |parent_candidate: &LargeBody| parent_candidate.place == place as usize;
        self.parent_candidates.iter().any(holds) || self.other_parents.binary_search(&place).is_ok()
    }

    /// Keeps the largest moving bodies that are not attached.
    fn consider(&mut self, radius: f64, place: usize) {
        let full = self.largest.len() == PARENT_CANDIDATES_MAX;
        if full && self.largest[PARENT_CANDIDATES_MAX - 1].0 >= radius {
            return;
        }
        let at = self.largest.partition_point(|(other, _)| *other >= radius);
        self.largest.insert(at, (radius, place));
        self.largest.truncate(PARENT_CANDIDATES_MAX);
    }
}

impl Publisher {
    /// Scans the observations of a tick.
    pub(super) fn scan(
        &mut self,
        tick: Tick,
        observations: &[Observation],
        scan: &mut ObservationScan,
    ) {
        scan.undecided.clear();
        scan.largest.clear();
        scan.parent_candidates.clear();
        let mut least = f64::INFINITY;
        self.statistics.checked += observations.len() as u64;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = self.observed_slot(observation) else {
                continue;
            };
            let radius = self.tracks.radius(slot).metres();
            least = least.min(radius);
            if self.features.attached && slot.parent().is_none() {
                scan.consider(radius, place);
            }
            let place = place as u32;
            if observation.activity == Activity::Asleep || !self.features.prefilter {
                scan.undecided.push(place);
                continue;
            }
            let ObservationScan {
                prefilter,
                undecided,
                ..
            } = scan;
            let observed = (place, &observation.motion);
            self.tracks.look(slot, tick, observed, prefilter, undecided);
        }
        scan.prefilter.finish(&mut scan.undecided);
        // Moving bodies are tested four at a time, so their results come late.
        scan.undecided.sort_unstable();
        let large = |(radius, _): &&(f64, usize)| *radius >= least * PARENT_SIZE_RATIO;
        let largest = scan.largest.iter().take_while(large);
        scan.parent_candidates
            .extend(largest.map(|(radius, place)| LargeBody {
                place: *place,
                position: Vec3::from_array(observations[*place].motion.position()),
                radius: *radius,
            }));
    }

    /// Collects undecided bodies with children that are no parent candidates.
    pub(super) fn scan_other_parents(
        &self,
        observations: &[Observation],
        scan: &mut ObservationScan,
    ) {
        let (parent_candidates, undecided) = (&scan.parent_candidates, &scan.undecided);
        let other_parents = |place: &u32| {
            let place = *place as usize;
            let holds = |parent_candidate: &LargeBody| parent_candidate.place == place;
            self.holds(observations[place].id.index()) && !parent_candidates.iter().any(holds)
        };
        scan.other_parents.clear();
        scan.other_parents
            .extend(undecided.iter().copied().filter(other_parents));
    }
}
