//! The published tracks of a stream: what its subscribers know of each body.
//!
//! A converged subscriber holds the same tracks. Decides nothing. Invariant: the numbers of children are those of the
//! tracks' parents.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Tick, Track};

use super::child_counts::ChildCounts;
use crate::packet::{Keyframe, RefreshRecord, Update, UpdatePayload};
use crate::stream::aliases::{AliasMap, AliasTable};
use crate::stream::observation::Observation;
use crate::stream::stream_config::StreamConfig;
use crate::stream::tracks::{PredictionParameters, Slot, Tracks};

/// The tracks, aliases and numbers of children of a stream's bodies.
#[derive(Debug)]
pub(super) struct PublishedTracks {
    tracks: Tracks,
    alias_table: AliasTable,
    child_counts: ChildCounts,
    /// True if bodies have short aliases. Otherwise the alias of a body is its index.
    short_aliases: bool,
    /// Bodies that came to rest at this tick. Packets of this tick still use their aliases.
    resting_bodies: Vec<u32>,
}

impl PublishedTracks {
    /// The tracks of a stream without bodies.
    pub(super) fn new(config: &StreamConfig) -> Self {
        Self {
            tracks: Tracks::new(
                config.tolerance,
                config.integrator,
                config.publish_interval,
                config.gravity,
            ),
            alias_table: AliasTable::default(),
            child_counts: ChildCounts::default(),
            short_aliases: config.features.aliases,
            resting_bodies: Vec::new(),
        }
    }

    /// Places a body; `false` if the table is full.
    #[must_use]
    pub(super) fn place(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
    ) -> bool {
        let attached_to = self.tracks.slot(id.index()).and_then(Slot::parent);
        let placed = self.tracks.place(id, parameters, track, None);
        if placed {
            self.alias_table.release(id.index());
            self.child_counts.move_child(attached_to, track.parent);
        }
        placed
    }

    /// Removes a body. Its children still name it as their parent.
    pub(super) fn remove(&mut self, id: BodyId) {
        let attached_to = self.tracks.slot(id.index()).and_then(Slot::parent);
        if self.tracks.remove(id) {
            self.alias_table.release(id.index());
            self.child_counts.move_child(attached_to, None);
        }
    }

    /// Changes the gravity from this tick on.
    pub(super) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
    }

    /// Begins a tick: aliases freed before can be assigned again.
    pub(super) fn begin_tick(&mut self) {
        self.alias_table.begin_tick();
    }

    /// Replaces the track of a body and returns the update that does the same at a subscriber.
    pub(super) fn replace(&mut self, index: u32, payload: UpdatePayload, track: Track) -> Update {
        let before = self.tracks.slot(index).and_then(Slot::parent);
        self.tracks.set_track(index, track);
        if before != track.parent {
            self.child_counts.move_child(before, track.parent);
        }
        let (alias, taken) = if self.short_aliases {
            self.alias_table.alias(index)
        } else {
            self.alias_table.alias_of_index(index)
        };
        if track.is_exact_rest() {
            self.resting_bodies.push(index);
        }
        let named = taken || matches!(payload, UpdatePayload::Keyframe(_));
        Update {
            alias,
            body: named.then_some(index),
            payload,
        }
    }

    /// Ends a tick, after its packets were made: the bodies that came to rest lose their aliases.
    pub(super) fn end_tick(&mut self) {
        for index in self.resting_bodies.drain(..) {
            if self.short_aliases {
                self.alias_table.release(index);
            }
        }
    }

    /// See [`Tracks::settle_checksum`].
    pub(super) fn settle_checksum(&mut self) -> u64 {
        self.tracks.settle_checksum()
    }

    /// The table of tracks.
    pub(super) const fn tracks(&self) -> &Tracks {
        &self.tracks
    }

    /// The present aliases.
    pub(super) const fn aliases(&self) -> &AliasMap<()> {
        self.alias_table.aliases()
    }

    /// True if bodies are attached to this one.
    pub(super) fn has_children(&self, index: u32) -> bool {
        self.child_counts.has_children(index)
    }

    /// The slot of a body observed at a tick. None if it came later, or if another body has the index.
    #[inline]
    pub(super) fn observed(&self, tick: Tick, observation: &Observation) -> Option<&Slot> {
        let slot = self.tracks.slot(observation.id.index())?;
        let there = slot.id(observation.id.index()) == observation.id;
        (there && slot.origin() <= tick).then_some(slot)
    }

    /// The record of a body in a refresh at a tick.
    pub(super) fn refresh_record(&self, index: u32, tick: Tick) -> Option<RefreshRecord> {
        let slot = self.tracks.slot(index)?;
        Some(RefreshRecord {
            index,
            alias: self.aliases().of(index),
            age: tick.since(slot.origin()).unwrap_or_default(),
            keyframe: Keyframe::of(&slot.track()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Grid, Metres, Predictor, QuantisedState, Tolerance};

    const BODIES: u32 = 8;

    fn published() -> PublishedTracks {
        PublishedTracks::new(&StreamConfig::PLAIN)
    }

    fn still() -> BodyState {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        still.expect("it is finite")
    }

    /// A track at rest, or one that is attached to another body.
    fn track(tick: u64, parent: Option<u32>) -> Track {
        let resting = Track::resting(Tick::new(tick), still());
        let Some(parent) = parent else {
            return resting;
        };
        let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
        Track {
            predictor: Predictor::Uniform,
            anchor: Anchor::Quantised(QuantisedState::of(&still().motion(), &grid)),
            parent: Some(id(parent)),
            ..resting
        }
    }

    const fn id(index: u32) -> BodyId {
        BodyId::new(index, 0)
    }

    fn place(published: &mut PublishedTracks, index: u32, parent: Option<u32>) {
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        assert!(published.place(id(index), &parameters, track(0, parent)));
    }

    #[derive(Clone, Copy, Debug)]
    enum TrackChange {
        Place(u32, Option<u32>),
        Replace(u32, Option<u32>),
        Remove(u32),
    }

    fn track_change() -> impl Strategy<Value = TrackChange> {
        let parent = || proptest::option::of(0..BODIES);
        prop_oneof![
            (0..BODIES, parent()).prop_map(|(index, parent)| TrackChange::Place(index, parent)),
            (0..BODIES, parent()).prop_map(|(index, parent)| TrackChange::Replace(index, parent)),
            (0..BODIES).prop_map(TrackChange::Remove),
        ]
    }

    proptest! {
        #[test]
        fn a_body_has_as_many_children_as_tracks_name_it(
            changes in proptest::collection::vec(track_change(), 0..100),
        ) {
            let mut published = published();
            for change in changes {
                match change {
                    TrackChange::Place(index, parent) => place(&mut published, index, parent),
                    TrackChange::Replace(index, parent) => {
                        if published.tracks().slot(index).is_some() {
                            let track = track(1, parent);
                            let payload = UpdatePayload::Keyframe(Keyframe::of(&track));
                            published.replace(index, payload, track);
                        }
                    }
                    TrackChange::Remove(index) => published.remove(id(index)),
                }
                for index in 0..BODIES {
                    let parents = published.tracks().iter().filter_map(|(_, slot)| slot.parent());
                    let children = parents.filter(|parent| parent.index() == index).count() as u32;
                    prop_assert_eq!(published.child_counts.of(index), children);
                }
            }
        }
    }

    #[test]
    fn a_body_that_comes_to_rest_keeps_its_alias_until_the_packets_of_the_tick_are_made() {
        let mut published = published();
        place(&mut published, 5, None);
        published.begin_tick();
        let track = track(1, None);
        let payload = UpdatePayload::Keyframe(Keyframe::of(&track));
        let update = published.replace(5, payload, track);
        assert_eq!((update.alias, update.body), (0, Some(5)));
        assert_eq!(published.aliases().body(0), Some(5));
        published.end_tick();
        assert_eq!(published.aliases().body(0), None);
    }

    #[test]
    fn a_body_is_observed_from_its_placement_on_and_only_by_its_own_id() {
        let mut published = published();
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        assert!(published.place(id(2), &parameters, track(10, None)));
        let observation = |id| Observation {
            id,
            motion: still(),
            activity: crate::stream::observation::Activity::Awake,
        };
        let is_observed = |tick, id| {
            published
                .observed(Tick::new(tick), &observation(id))
                .is_some()
        };
        assert!(is_observed(10, id(2)));
        assert!(!is_observed(9, id(2)));
        assert!(!is_observed(10, BodyId::new(2, 1)));
        assert!(!is_observed(10, id(3)));
    }
}
