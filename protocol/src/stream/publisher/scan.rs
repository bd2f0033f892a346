//! The scan of observations: tracks out of tolerance and parent candidates.
//!
//! One pass over the observations. Bodies that surely hold cost nothing more. Changes no track.

use glam::Vec3;
use rhumb_reckoning::Tick;

use super::Publisher;
use super::large_body::{LargeBody, PARENT_SIZE_RATIO};
use super::observation_scan::ObservationScan;
use crate::stream::observation::{Activity, Observation};

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
            let observed = (place, &observation.motion);
            let ObservationScan {
                prefilter, tested, ..
            } = scan;
            let undecided = self
                .tracks
                .prefilter(slot, tick, observed, prefilter, tested);
            if undecided {
                scan.undecided.push(place);
            }
        }
        scan.prefilter.finish(&mut scan.tested);
        scan.merge_tested();
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
