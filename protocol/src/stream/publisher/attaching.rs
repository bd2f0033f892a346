//! The bodies that can be parents of others, and the number of their children.

use glam::Vec3;
use rhumb_reckoning::{BodyId, Ticks};

use super::Publisher;
use super::large_body::{LargeBody, ObservedParent, PARENT_SIZE_RATIO};
use super::observation_scan::ObservationScan;
use super::window::{Ahead, ObservationWindow, ObservedTicks};
use crate::stream::observation::Observation;
use crate::stream::observation_history::ObservationHistory;

/// A child lies within this many radii of its parent.
const PARENT_REACH: f64 = 3.0;
/// With lookahead, a parent is kept within this share of its tolerance, because its error adds to that of its children.
const PARENT_TOLERANCE_SHARE: f64 = 0.5;

impl Publisher {
    /// The share of its tolerance within which a body is kept.
    pub(super) fn closeness(&self, observation_history: &ObservationHistory, index: u32) -> f64 {
        let predicted_after =
            self.features.mode_decision && observation_history.lookahead() > Ticks::ZERO;
        if predicted_after && self.holds(index) {
            PARENT_TOLERANCE_SHARE
        } else {
            1.0
        }
    }

    /// Collects the observations of the parent candidates.
    pub(super) fn observe_parents(&self, ticks: &ObservedTicks<'_>, scan: &mut ObservationScan) {
        let tick = ticks.tick;
        let observations = ticks.history.at(tick).unwrap_or_default();
        let observed = |LargeBody { place, .. }: &LargeBody| {
            let Observation { id, motion, .. } = observations[*place];
            let slot = self.tracks.slot(id.index())?;
            let window = ObservationWindow::of(ticks, id, *place);
            Some(ObservedParent {
                index: id.index(),
                truth: motion.motion(),
                predicted_motion: self.tracks.framed((id.index(), slot), &slot.track(), tick),
                past: window.past.map(Option::<&_>::copied),
                stride: window.stride,
                ahead: Ahead::of(ticks, id, *place),
            })
        };
        scan.observed_parents.clear();
        scan.observed_parents
            .extend(scan.parent_candidates.iter().filter_map(observed));
    }

    /// The best parent for a body: its present parent, or the nearest candidate within reach.
    pub(super) fn parent_candidate_of<'s>(
        &self,
        observation: &Observation,
        scan: &'s ObservationScan,
    ) -> Option<&'s ObservedParent> {
        let slot = self.tracks.slot(observation.id.index())?;
        let parent_candidates = &scan.parent_candidates;
        if let Some(parent) = slot.parent() {
            let holds = |observed: &&ObservedParent| observed.index == parent.index();
            return scan.observed_parents.iter().find(holds);
        }
        let least = self.tracks.radius(slot).metres() * PARENT_SIZE_RATIO;
        let here = Vec3::from_array(observation.motion.position());
        let reaches = |parent_candidate: &LargeBody| {
            let far = f64::from(parent_candidate.position.distance(here));
            parent_candidate.radius >= least && far <= parent_candidate.radius * PARENT_REACH
        };
        let far = |parent_candidate: &LargeBody| parent_candidate.position.distance_squared(here);
        let near = parent_candidates.iter().zip(&scan.observed_parents);
        let near = near.filter(|(parent_candidate, _)| reaches(parent_candidate));
        near.min_by(|(a, _), (b, _)| far(a).total_cmp(&far(b)))
            .map(|(_, observed)| observed)
    }

    /// True if a body has children.
    pub(super) fn holds(&self, index: u32) -> bool {
        let index_of = |(parent_candidate, _): &(u32, u32)| *parent_candidate;
        self.child_counts
            .binary_search_by_key(&index, index_of)
            .is_ok()
    }

    /// Moves a child from one parent to another in the counts.
    pub(super) fn move_child(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        let place = |child_counts: &[(u32, u32)], id: BodyId| {
            child_counts
                .binary_search_by_key(&id.index(), |(parent_candidate, _)| *parent_candidate)
        };
        if let Some(from) = from
            && let Ok(at) = place(&self.child_counts, from)
        {
            self.child_counts[at].1 -= 1;
            if self.child_counts[at].1 == 0 {
                self.child_counts.remove(at);
            }
        }
        if let Some(to) = to {
            match place(&self.child_counts, to) {
                Ok(at) => self.child_counts[at].1 += 1,
                Err(at) => self.child_counts.insert(at, (to.index(), 1)),
            }
        }
    }
}
