//! Which body could hold another, and how many each holds.

use glam::Vec3;
use rhumb_reckoning::{BodyId, Ticks};

use super::Publisher;
use crate::stream::observation::Observation;
use crate::stream::observation_history::ObservationHistory;

/// Bodies that others may be held by, at one tick: the largest that move.
pub(super) const PARENT_CANDIDATES_MAX: usize = 16;
/// A parent_candidate is larger than what it holds by this factor at least.
pub(super) const PARENT_SIZE_RATIO: f64 = 1.2;
/// A body is held within this many radii of its parent_candidate.
const PARENT_REACH: f64 = 3.0;
/// With lookahead, who holds others is followed within this share of its tolerance: all that it holds is off with it.
const PARENT_TOLERANCE_SHARE: f64 = 0.5;

/// A body that could hold others, at one tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct LargeBody {
    /// Its place among those that were seen.
    pub(super) place: usize,
    pub(super) position: Vec3,
    /// Metres.
    pub(super) radius: f64,
}

impl Publisher {
    /// Within what share of its tolerance a body is followed.
    pub(super) fn closeness(&self, observation_history: &ObservationHistory, index: u32) -> f64 {
        let predicted_after =
            self.features.mode_decision && observation_history.lookahead() > Ticks::ZERO;
        if predicted_after && self.holds(index) {
            PARENT_TOLERANCE_SHARE
        } else {
            1.0
        }
    }

    /// The place of the body that could hold another: the one that does, or the nearest within reach.
    pub(super) fn parent_candidate_of(
        &self,
        observation: &Observation,
        parent_candidates: &[LargeBody],
        observations: &[Observation],
    ) -> Option<usize> {
        let slot = self.tracks.slot(observation.id.index())?;
        if let Some(parent) = slot.parent() {
            let holds =
                |parent_candidate: &&LargeBody| observations[parent_candidate.place].id == parent;
            return parent_candidates
                .iter()
                .find(holds)
                .map(|parent_candidate| parent_candidate.place);
        }
        let least = self.tracks.radius(slot).metres() * PARENT_SIZE_RATIO;
        let here = Vec3::from_array(observation.motion.position());
        let reaches = |parent_candidate: &&LargeBody| {
            let far = f64::from(parent_candidate.position.distance(here));
            parent_candidate.radius >= least && far <= parent_candidate.radius * PARENT_REACH
        };
        let far = |parent_candidate: &LargeBody| parent_candidate.position.distance_squared(here);
        let near = parent_candidates.iter().filter(reaches);
        near.min_by(|a, b| far(a).total_cmp(&far(b)))
            .map(|parent_candidate| parent_candidate.place)
    }

    /// Whether a body holds another.
    pub(super) fn holds(&self, index: u32) -> bool {
        let known = |(parent_candidate, _): &(u32, u32)| *parent_candidate;
        self.child_counts
            .binary_search_by_key(&index, known)
            .is_ok()
    }

    /// A body was held by the one and is held by the other from now on.
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
