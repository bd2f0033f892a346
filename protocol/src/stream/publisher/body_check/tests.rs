//! Checks of bodies: published tracks, updates, parents of attached bodies.

use alloc::collections::BTreeMap;

use proptest::prelude::*;
use rhumb_reckoning::BodyId;

use super::*;
use crate::stream::observation_history::Activity;

mod body_check {
    use proptest::array::uniform3;
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyId, BodyState, Metres, Tick};

    use super::super::*;
    use crate::scene::PublishSchedule;
    use crate::stream::StreamConfig;
    use crate::stream::observation_history::ObservationHistory;
    use crate::stream::tracks::PredictionParameters;

    const TICK: Tick = Tick::new(3);
    const BODY: BodyId = BodyId::new(4, 0);

    fn state(position: [f32; 3], velocity: [f32; 3]) -> BodyState {
        let state = BodyState::new(position, [0.0, 0.0, 0.0, 1.0], velocity, [0.0; 3]);
        state.expect("it is finite")
    }

    /// A body that rests at the origin of the scene.
    fn published() -> PublishedTracks {
        let mut published = PublishedTracks::new(&StreamConfig::PLAIN);
        let resting = Track::resting(Tick::ZERO, state([0.0; 3], [0.0; 3]));
        assert!(published.place(
            BODY,
            &PredictionParameters::plain(Metres::new(0.5)),
            resting
        ));
        published
    }

    /// Checks the body at the tick, by one observation.
    fn check(
        published: &mut PublishedTracks,
        motion: BodyState,
        activity: Activity,
    ) -> (Option<Need>, Option<Update>) {
        let observation = Observation {
            id: BODY,
            motion,
            activity,
        };
        let mut history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        history.observe(TICK, &[observation]);
        let check = BodyCheck::new(ObservedTicks::around(&history, TICK), Features::ALL);
        let need = check.need(published, &observation);
        (need, check.update(published, (0, &observation), None))
    }

    /// The share of its tolerance that the body's track uses.
    fn used(published: &PublishedTracks, motion: BodyState) -> f64 {
        let (tracks, slot) = (published.tracks(), published.tracks().slot(BODY.index()));
        let slot = slot.expect("it is placed");
        let predicted = tracks.predicted_motion((BODY.index(), slot), TICK);
        share_used(tracks, slot, &motion.motion(), &predicted)
    }

    proptest! {
        #[test]
        fn a_track_is_replaced_only_beyond_the_tolerance_and_then_within_it(
            (position, velocity) in (uniform3(-0.2_f32..0.2), uniform3(-30.0_f32..30.0)),
        ) {
            let mut published = published();
            let motion = state(position, velocity);
            let before = used(&published, motion);
            let (need, update) = check(&mut published, motion, Activity::Awake);
            prop_assert_eq!(need.is_some(), before > 1.0);
            prop_assert_eq!(update.is_some(), before > 1.0);
            prop_assert!(used(&published, motion) <= 1.0);
        }
    }

    #[test]
    fn a_sleeping_body_gets_its_exact_pose_once_and_a_woken_one_within_the_tolerance_nothing() {
        let mut published = published();
        let (asleep, near) = (
            state([0.3, 0.0, 0.0], [0.0; 3]),
            state([0.3001, 0.0, 0.0], [0.0; 3]),
        );
        let (need, update) = check(&mut published, asleep, Activity::Asleep);
        assert!(need.is_some() && update.is_some());
        let slot = published.tracks().slot(BODY.index());
        let track = slot.map(Slot::track);
        assert_eq!(track, Some(Track::resting(TICK, asleep)));
        for (motion, activity) in [(asleep, Activity::Asleep), (near, Activity::Awake)] {
            assert_eq!(check(&mut published, motion, activity), (None, None));
        }
    }
}

mod published_tracks {
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Grid, Metres, Predictor, QuantisedState, Tolerance};

    use super::super::*;

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
            activity: Activity::Awake,
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
