//! The bodies that others are or may be attached to.
//!
//! Changes no track. Buffers are reused from tick to tick. Invariants: candidates, the largest moving bodies of a
//! tick, are sorted by radius, the largest first. The bodies that have children are few, so they are kept in a short
//! list that rises by index, in which no count is zero.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, BodyState, Motion, Ticks};

use crate::stream::observation_history::{Ahead, Observation, ObservationWindow, ObservedTicks};
use crate::stream::tracks::Tracks;

/// The number of parent candidates at one tick: the largest moving bodies.
const PARENT_CANDIDATES_MAX: usize = 16;
/// A parent is larger than its child by this factor at least.
const PARENT_SIZE_RATIO: f64 = 1.2;
/// A child lies within this many radii of its parent.
const PARENT_REACH: f64 = 3.0;

/// A parent candidate at one tick.
#[derive(Clone, Copy, Debug)]
struct LargeBody {
    /// Its position among the observations.
    place: usize,
    position: Vec3,
    /// The radius, metres.
    radius: f64,
}

/// A parent candidate with its observations, the same for all its possible children.
#[derive(Clone, Debug)]
pub(super) struct ObservedParent {
    pub(super) index: u32,
    pub(super) truth: Motion,
    /// The motion in the frame of its track, after its own update of the tick.
    pub(super) predicted_motion: Motion,
    /// Its states one and two strides before.
    pub(super) past: [Option<BodyState>; 2],
    pub(super) stride: Ticks,
    pub(super) ahead: Option<Ahead>,
}

/// The parent candidates of a tick, first by size and then with their observations.
#[derive(Clone, Debug)]
pub(super) struct ParentCandidates {
    /// The largest bodies so far, with their radii, metres.
    largest: Vec<(f64, usize)>,
    candidates: Vec<LargeBody>,
    /// The same bodies with their observations.
    observed: Vec<ObservedParent>,
}

impl ParentCandidates {
    pub(super) fn new() -> Self {
        Self {
            largest: Vec::with_capacity(PARENT_CANDIDATES_MAX + 1),
            candidates: Vec::new(),
            observed: Vec::new(),
        }
    }

    /// Begins a tick without candidates.
    pub(super) fn clear(&mut self) {
        self.largest.clear();
        self.candidates.clear();
        self.observed.clear();
    }

    /// Keeps the largest of the bodies that are considered. Each must move and not be attached.
    pub(super) fn consider(&mut self, radius: f64, place: usize) {
        let full = self.largest.len() == PARENT_CANDIDATES_MAX;
        if full && self.largest[PARENT_CANDIDATES_MAX - 1].0 >= radius {
            return;
        }
        let at = self.largest.partition_point(|(other, _)| *other >= radius);
        self.largest.insert(at, (radius, place));
        self.largest.truncate(PARENT_CANDIDATES_MAX);
    }

    /// Chooses the candidates: those of the largest bodies that could have the smallest body as their child.
    ///
    /// `least`: the least radius of all observed bodies, metres.
    pub(super) fn choose(&mut self, least: f64, observations: &[Observation]) {
        let large = |(radius, _): &&(f64, usize)| *radius >= least * PARENT_SIZE_RATIO;
        let largest = self.largest.iter().take_while(large);
        self.candidates
            .extend(largest.map(|(radius, place)| LargeBody {
                place: *place,
                position: Vec3::from_array(observations[*place].motion.position()),
                radius: *radius,
            }));
    }

    /// Collects the observations of the candidates, after their own updates of the tick.
    pub(super) fn observe(&mut self, tracks: &Tracks, ticks: &ObservedTicks<'_>) {
        let observed = |LargeBody { place, .. }: &LargeBody| {
            let Observation { id, motion, .. } = ticks.present[*place];
            let slot = tracks.slot(id.index())?;
            let window = ObservationWindow::of(ticks, id, *place);
            Some(ObservedParent {
                index: id.index(),
                truth: motion.motion(),
                predicted_motion: tracks.framed((id.index(), slot), &slot.track(), ticks.tick),
                past: window.past.map(Option::<&_>::copied),
                stride: window.stride,
                ahead: Ahead::of(ticks, id, *place),
            })
        };
        self.observed
            .extend(self.candidates.iter().filter_map(observed));
    }

    /// The positions of the candidates among the observations.
    pub(super) fn places(&self) -> impl Iterator<Item = usize> {
        self.candidates.iter().map(|candidate| candidate.place)
    }

    /// True if the body at a position among the observations is a candidate.
    pub(super) fn contains(&self, place: usize) -> bool {
        self.places().any(|candidate| candidate == place)
    }

    /// The best parent for a body: its present parent, or the nearest candidate within reach.
    pub(super) fn parent_of(
        &self,
        tracks: &Tracks,
        observation: &Observation,
    ) -> Option<&ObservedParent> {
        let slot = tracks.slot(observation.id.index())?;
        if let Some(parent) = slot.parent() {
            let holds = |observed: &&ObservedParent| observed.index == parent.index();
            return self.observed.iter().find(holds);
        }
        let least = tracks.radius(slot).metres() * PARENT_SIZE_RATIO;
        let here = Vec3::from_array(observation.motion.position());
        let reaches = |candidate: &LargeBody| {
            let far = f64::from(candidate.position.distance(here));
            candidate.radius >= least && far <= candidate.radius * PARENT_REACH
        };
        let far = |candidate: &LargeBody| candidate.position.distance_squared(here);
        let near = self.candidates.iter().zip(&self.observed);
        let near = near.filter(|(candidate, _)| reaches(candidate));
        near.min_by(|(a, _), (b, _)| far(a).total_cmp(&far(b)))
            .map(|(_, observed)| observed)
    }
}

/// Parents and their numbers of children, in order of index.
#[derive(Clone, Debug, Default)]
pub(super) struct ChildCounts {
    counts: Vec<(u32, u32)>,
}

impl ChildCounts {
    /// Moves a child from one parent to another.
    pub(super) fn move_child(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        if let Some(from) = from
            && let Ok(at) = self.place(from.index())
        {
            self.counts[at].1 -= 1;
            if self.counts[at].1 == 0 {
                self.counts.remove(at);
            }
        }
        if let Some(to) = to {
            match self.place(to.index()) {
                Ok(at) => self.counts[at].1 += 1,
                Err(at) => self.counts.insert(at, (to.index(), 1)),
            }
        }
    }

    /// True if a body has children.
    pub(super) fn has_children(&self, index: u32) -> bool {
        self.place(index).is_ok()
    }

    /// The position of a parent in the list, or where it would be inserted.
    fn place(&self, index: u32) -> Result<usize, usize> {
        self.counts
            .binary_search_by_key(&index, |(parent, _)| *parent)
    }

    /// The number of children of a body.
    #[cfg(test)]
    pub(super) fn of(&self, index: u32) -> u32 {
        self.place(index).map_or(0, |at| self.counts[at].1)
    }
}

#[cfg(test)]
mod tests {
    use alloc::collections::BTreeMap;

    use proptest::prelude::*;
    use rhumb_reckoning::BodyId;

    use super::*;
    use crate::stream::observation_history::Activity;

    fn observation(index: usize) -> Observation {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Observation {
            id: BodyId::new(index as u32, 0),
            motion: still.expect("it is finite"),
            activity: Activity::Awake,
        }
    }

    proptest! {
        #[test]
        fn the_candidates_are_the_largest_bodies_that_exceed_the_smallest(
            radii in proptest::collection::vec(1_u32..40, 0..60),
        ) {
            let observations: Vec<_> = (0..radii.len()).map(observation).collect();
            let radius = |place: usize| f64::from(radii[place]);
            let least = radii.iter().copied().min().map_or(f64::INFINITY, f64::from);
            let mut candidates = ParentCandidates::new();
            for place in 0..radii.len() {
                candidates.consider(radius(place), place);
            }
            candidates.choose(least, &observations);
            // Bodies of one size keep their order.
            let mut expected: Vec<usize> = (0..radii.len()).collect();
            expected.sort_by_key(|place| core::cmp::Reverse(radii[*place]));
            expected.truncate(PARENT_CANDIDATES_MAX);
            expected.retain(|place| radius(*place) >= least * PARENT_SIZE_RATIO);
            prop_assert!(candidates.places().eq(expected.iter().copied()));
            for place in 0..radii.len() {
                prop_assert_eq!(candidates.contains(place), expected.contains(&place));
            }
            candidates.clear();
            prop_assert_eq!(candidates.places().count(), 0);
        }
    }

    proptest! {
        #[test]
        fn each_parent_has_as_many_children_as_moved_to_it(
            moves in proptest::collection::vec((0_usize..30, proptest::option::of(0_u32..8)), 0..200),
        ) {
            let mut child_counts = ChildCounts::default();
            let mut parents = BTreeMap::new();
            for (child, to) in moves {
                let to = to.map(|index| BodyId::new(index, 0));
                let from = parents.insert(child, to).flatten();
                child_counts.move_child(from, to);
                for index in 0..10 {
                    let is_child = |parent: &&Option<BodyId>| parent.map(BodyId::index) == Some(index);
                    let expected = parents.values().filter(is_child).count() as u32;
                    prop_assert_eq!(child_counts.of(index), expected);
                    prop_assert_eq!(child_counts.has_children(index), expected > 0);
                }
                prop_assert!(child_counts.counts.is_sorted());
            }
        }
    }
}
