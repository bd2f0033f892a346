//! The scan of a tick: finds the bodies whose tracks may not hold.
//!
//! One pass over the observations that changes no track. Bodies that surely hold cost nothing more. What the pass needs
//! of a track is kept in one place, in the order of indices. Invariants: positions in `undecided` and `other_parents` rise;
//! after a tick, `tracks` has what the published tracks are.

use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, ErrorPrefilter, PrefilterInput, PrefilterTrack, Tick, Ticks};

use super::body_check::{PARENT_SIZE_RATIO, ParentCandidates, PublishedTracks};
use crate::interner::grow_to;
use crate::stream::observation_history::{Activity, Observation, ObservedTicks};
use crate::stream::tracks::{Slot, Tracks};
use crate::stream::{Features, StreamConfig};

/// A track that is older counts as one of this age: only a resting body has one.
const AGE_MAX: Ticks = Ticks::new(u32::MAX);

/// The track of a body as the scan takes it.
#[derive(Clone, Copy, Debug)]
struct ScannedTrack {
    origin: Tick,
    /// None if only the exact judgement can compare it.
    tested: Option<PrefilterTrack>,
    generation: u16,
    /// The number of its table of damping.
    flow: u16,
    /// The number of its prediction parameters: bodies of one number have one size.
    interned: u32,
}

/// The tracks of all bodies, by index.
#[derive(Clone, Debug, Default)]
struct ScannedTracks(Vec<Option<ScannedTrack>>);

impl ScannedTracks {
    /// Notes what stands in the table of tracks at an index.
    fn note(&mut self, tracks: &Tracks, index: u32, prefilter: &ErrorPrefilter) {
        let scanned = tracks.slot(index).map(|slot| {
            let (tested, flow) = tracks.prefilter_track(slot, prefilter);
            ScannedTrack {
                origin: slot.origin(),
                tested,
                generation: slot.id(index).generation(),
                flow,
                interned: slot.interned(),
            }
        });
        if scanned.is_some() {
            grow_to(&mut self.0, index as usize + 1, || None);
        }
        if let Some(place) = self.0.get_mut(index as usize) {
            *place = scanned;
        }
    }

    /// The track of a body; `None` if another body or none has its index.
    #[inline]
    fn of(&self, id: BodyId) -> Option<&ScannedTrack> {
        let scanned = self.0.get(id.index() as usize)?.as_ref();
        scanned.filter(|scanned| scanned.generation == id.generation())
    }
}

/// The result of a scan, as positions among the observations. Its buffers are reused from tick to tick.
#[derive(Clone, Debug)]
pub(super) struct ObservationScan {
    features: Features,
    prefilter: ErrorPrefilter,
    tracks: ScannedTracks,
    /// Bodies whose tracks may not hold, in order.
    undecided: Vec<u32>,
    /// Undecided bodies that the prefilter tested four at a time, or that are added, in order, until they are merged into
    /// the others.
    tested: Vec<u32>,
    /// The least and the greatest radius of the observed bodies, metres.
    radii: [f64; 2],
    /// Undecided bodies with children that are no parent candidates, in order.
    other_parents: Vec<u32>,
    parent_candidates: ParentCandidates,
}

impl ObservationScan {
    pub(super) fn new(config: &StreamConfig) -> Self {
        Self {
            features: config.features,
            prefilter: ErrorPrefilter::new(config.tolerance, config.integrator),
            tracks: ScannedTracks::default(),
            undecided: Vec::new(),
            tested: Vec::new(),
            radii: [f64::INFINITY, 0.0],
            other_parents: Vec::new(),
            parent_candidates: ParentCandidates::new(),
        }
    }

    /// Notes the track of an index, which has changed: it may have no body any more.
    pub(super) fn note_track(&mut self, tracks: &Tracks, index: u32) {
        self.tracks.note(tracks, index, &self.prefilter);
    }

    /// Notes the tracks of all bodies.
    pub(super) fn note_all(&mut self, tracks: &Tracks) {
        for (index, _) in tracks.iter() {
            self.note_track(tracks, index);
        }
    }

    /// Notes the tracks that the updates of a tick have replaced.
    pub(super) fn note_updated(&mut self, tracks: &Tracks, ticks: &ObservedTicks<'_>) {
        let undecided = self.undecided.iter().map(|place| *place as usize);
        for place in undecided.chain(self.parent_candidates.places()) {
            let index = ticks.present[place].id.index();
            let origin = tracks.slot(index).map(Slot::origin);
            if origin == Some(ticks.tick) {
                self.tracks.note(tracks, index, &self.prefilter);
            }
        }
    }

    /// Scans the observations of a tick.
    pub(super) fn scan(&mut self, tracks: &Tracks, tick: Tick, observations: &[Observation]) {
        self.undecided.clear();
        self.parent_candidates.clear();
        self.radii = [f64::INFINITY, 0.0];
        let mut last_size = None;
        let mut batch = self.prefilter.batch();
        for (place, observation) in (0..).zip(observations) {
            let scanned = self.tracks.of(observation.id);
            // A body may have come later.
            let Some(scanned) = scanned.filter(|scanned| scanned.origin <= tick) else {
                continue;
            };
            if last_size != Some(scanned.interned) {
                last_size = Some(scanned.interned);
                let radius = tracks.radius_of(scanned.interned).metres();
                let [least, greatest] = self.radii;
                self.radii = [least.min(radius), greatest.max(radius)];
            }
            let Some(track) = &scanned.tested else {
                self.undecided.push(place);
                continue;
            };
            if observation.activity == Activity::Asleep || !self.features.prefilter {
                self.undecided.push(place);
                continue;
            }
            let input = PrefilterInput {
                truth: &observation.motion,
                track,
                age: tick.since(scanned.origin).unwrap_or(AGE_MAX),
                flow: tracks.flow(scanned.flow),
            };
            if batch.test(place, &input, &mut self.tested) {
                self.undecided.push(place);
            }
        }
        batch.finish(&mut self.tested);
        self.merge_tested();
    }

    /// Finds the parent candidates among the observed bodies: none where all bodies are of about one size, or where nothing
    /// may be updated.
    pub(super) fn find_parent_candidates(
        &mut self,
        published: &PublishedTracks,
        (tick, observations): (Tick, &[Observation]),
    ) {
        let [least, greatest] = self.radii;
        let may_be_needed = !self.undecided.is_empty() || published.has_parents();
        if !self.features.attached || greatest < least * PARENT_SIZE_RATIO || !may_be_needed {
            return;
        }
        let tracks = published.tracks();
        for (place, observation) in observations.iter().enumerate() {
            let slot = published.observed(tick, observation);
            if let Some(slot) = slot.filter(|slot| slot.parent().is_none()) {
                let radius = tracks.radius(slot).metres();
                self.parent_candidates.consider(radius, place);
            }
        }
        self.parent_candidates.choose(least, observations);
    }

    /// Adds bodies whose tracks are replaced in any case; they are in order, as the observations are.
    pub(super) fn add(&mut self, bodies: &[BodyId], observations: &[Observation]) {
        for id in bodies {
            let place = observations.binary_search_by_key(id, |observation| observation.id);
            if let Ok(place) = place.map(|place| place as u32)
                && self.undecided.binary_search(&place).is_err()
            {
                self.tested.push(place);
            }
        }
        self.merge_tested();
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

    /// The positions of the undecided bodies.
    pub(super) fn undecided(&self) -> impl Iterator<Item = usize> {
        self.undecided.iter().map(|place| *place as usize)
    }

    /// The positions of the undecided bodies without those that are checked before: candidates and other parents.
    pub(super) fn others(&self) -> impl Iterator<Item = usize> {
        let others = self.undecided.iter().filter(|place| {
            !self.parent_candidates.contains(**place as usize)
                && self.other_parents.binary_search(place).is_err()
        });
        others.map(|place| *place as usize)
    }

    /// Merges the bodies that were tested four at a time, or are added, into the others.
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
    use proptest::prelude::*;

    use super::*;

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
