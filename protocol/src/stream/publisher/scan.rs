//! The look at what was seen: tracks in mismatch, and bodies that may hold others
//!
//! One pass over the observations; whatever it is sure of costs nothing more. It changes no track.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{ErrorPrefilter, Integrator, Tick, Tolerance};

use super::Publisher;
use super::attaching::{LargeBody, PARENT_CANDIDATES_MAX, PARENT_SIZE_RATIO};
use crate::stream::observation::{Activity, Observation};

/// What a look at the observations of a tick found; places among them. It keeps its room from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationScan {
    prefilter: ErrorPrefilter,
    /// Bodies whose tracks may not hold, in order.
    pub(super) undecided: Vec<u32>,
    /// Bodies that could hold others, the largest first.
    pub(super) parent_candidates: Vec<LargeBody>,
    /// Doubtful bodies that hold others and are not among those, in order.
    pub(super) other_parents: Vec<u32>,
    /// The largest so far, with their radii.
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

    /// Whether a body is spoken of before those that could be attached.
    pub(super) fn is_before(&self, place: u32) -> bool {
        let holds = |parent_candidate: &LargeBody| parent_candidate.place == place as usize;
        self.parent_candidates.iter().any(holds) || self.other_parents.binary_search(&place).is_ok()
    }

    /// Keeps the largest bodies that move and are not attached.
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
    /// Looks at what was seen at a tick.
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
        self.statistics.looked += observations.len() as u64;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = self.seen_slot(observation) else {
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
            let seen = (place, &observation.motion);
            self.tracks.look(slot, tick, seen, prefilter, undecided);
        }
        scan.prefilter.finish(&mut scan.undecided);
        // Answers about moving bodies come four at a time.
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

    /// Notes who of the undecided holds others, and is not among those who could.
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
