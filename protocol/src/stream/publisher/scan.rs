//! The scan of a tick: finds the bodies whose tracks may not hold.
//!
//! One pass over the observations that changes no track. Bodies that surely hold cost nothing more. The data that the pass needs
//! of a track is kept in one place while its body is awake. Invariants: positions in `undecided` and `other_parents` rise;
//! a track that is kept is the published one.

use alloc::vec::Vec;
use core::num::NonZeroU32;

use rhumb_reckoning::{
    BodyId, ErrorPrefilter, Metres, PrefilterInput, PrefilterTrack, Tick, Ticks,
};

use super::body_check::{PARENT_SIZE_RATIO, ParentCandidates, PublishedTracks};
use crate::interner::{grow_to, push};
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

/// The tracks of the awake bodies. Sleeping ones take no memory but a number.
#[derive(Clone, Debug, Default)]
struct ScannedTracks {
    tracks: Vec<ScannedTrack>,
    /// By index: the place of the body's track, plus one.
    places: Vec<Option<NonZeroU32>>,
    free: Vec<u32>,
}

impl ScannedTracks {
    /// Notes the track of a body.
    fn note(&mut self, tracks: &Tracks, (index, slot): (u32, &Slot), prefilter: &ErrorPrefilter) {
        let (tested, flow) = tracks.prefilter_track(slot, prefilter);
        let scanned = ScannedTrack {
            origin: slot.origin(),
            tested,
            generation: slot.id(index).generation(),
            flow,
            interned: slot.interned(),
        };
        grow_to(&mut self.places, index as usize + 1, || None);
        let place = &mut self.places[index as usize];
        if let Some(place) = *place {
            self.tracks[place.get() as usize - 1] = scanned;
        } else if let Some(free) = self.free.pop() {
            self.tracks[free as usize] = scanned;
            *place = NonZeroU32::new(free + 1);
        } else {
            push(&mut self.tracks, scanned);
            *place = NonZeroU32::new(self.tracks.len() as u32);
        }
    }

    /// Forgets the track of an index.
    fn forget(&mut self, index: u32) {
        let place = self.places.get_mut(index as usize);
        if let Some(place) = place.and_then(Option::take) {
            push(&mut self.free, place.get() - 1);
        }
    }

    /// The track of a body; `None` if it is not noted, or another body has its index.
    #[inline]
    fn of(&self, id: BodyId) -> Option<&ScannedTrack> {
        let place = (*self.places.get(id.index() as usize)?)?;
        let scanned = self.tracks.get(place.get() as usize - 1);
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

    /// Forgets the track of an index, which a scene event has changed: the next scan looks it up.
    pub(super) fn forget(&mut self, index: u32) {
        self.tracks.forget(index);
    }

    /// Forgets all tracks.
    pub(super) fn forget_all(&mut self) {
        self.tracks = ScannedTracks::default();
    }

    /// Notes the tracks that the updates of a tick have replaced, and those of bodies that woke up.
    pub(super) fn note_updated(&mut self, tracks: &Tracks, ticks: &ObservedTicks<'_>) {
        let undecided = self.undecided.iter().map(|place| *place as usize);
        for place in undecided.chain(self.parent_candidates.places()) {
            let Observation { id, activity, .. } = ticks.present[place];
            match tracks.slot(id.index()) {
                Some(slot) if activity == Activity::Awake => {
                    if slot.origin() == ticks.tick || self.tracks.of(id).is_none() {
                        self.tracks
                            .note(tracks, (id.index(), slot), &self.prefilter);
                    }
                }
                _ => self.tracks.forget(id.index()),
            }
        }
    }

    /// Scans the observations of a tick.
    pub(super) fn scan(
        &mut self,
        published: &PublishedTracks,
        tick: Tick,
        observations: &[Observation],
    ) {
        let tracks = published.tracks();
        self.undecided.clear();
        self.parent_candidates.clear();
        self.radii = [f64::INFINITY, 0.0];
        let mut last_size = None;
        let mut batch = self.prefilter.batch();
        for (place, observation) in (0..).zip(observations) {
            let Some(scanned) = self.tracks.of(observation.id) else {
                if let Some(slot) = published.observed(tick, observation) {
                    self.radii = with_radius(self.radii, tracks.radius(slot));
                    self.undecided.push(place);
                }
                continue;
            };
            let Some(age) = tick.value().checked_sub(scanned.origin.value()) else {
                // The body came later.
                continue;
            };
            if last_size != Some(scanned.interned) {
                last_size = Some(scanned.interned);
                self.radii = with_radius(self.radii, tracks.radius_of(scanned.interned));
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
                age: u32::try_from(age).map_or(AGE_MAX, Ticks::new),
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

/// The least and the greatest radius with one more, metres.
fn with_radius([least, greatest]: [f64; 2], radius: Metres) -> [f64; 2] {
    let radius = radius.metres();
    [least.min(radius), greatest.max(radius)]
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
