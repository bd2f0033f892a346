//! The check of one body at one tick, and its update if its track is off.
//!
//! Combines the tables of tracks with the mode decision. Keeps nothing. Invariant: a returned track is within the
//! tolerance of the observed state, grid error included.

use rhumb_reckoning::{
    Anchor, Motion, Predictor, QuantisedState, RestCorrection, TRACK_AGE_MAX, Ticks, Track,
    attached_motion,
};

use super::parent_candidates::ObservedParent;
use super::published_tracks::PublishedTracks;
use super::update_queue::Need;
use super::window::{Ahead, ObservationWindow, ObservedTicks};
use crate::packet::{Age, Keyframe, Update, UpdatePayload};
use crate::stream::features::Features;
use crate::stream::mode_decision::{Context, ModeDecision, Parent, Subject, share};
use crate::stream::observation::{Activity, Observation};
use crate::stream::tracks::{Slot, Tracks};

/// With lookahead, a parent is kept within this share of its tolerance, because its error adds to that of its children.
const PARENT_TOLERANCE_SHARE: f64 = 0.5;

/// The checks of a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct BodyCheck<'h> {
    ticks: ObservedTicks<'h>,
    features: Features,
    /// The factor on tolerances in lifetime estimates: above one if the budget does not suffice.
    slack: f64,
}

impl<'h> BodyCheck<'h> {
    /// Checks with the usual tolerances.
    pub(super) const fn new(ticks: ObservedTicks<'h>, features: Features) -> Self {
        Self {
            ticks,
            features,
            slack: 1.0,
        }
    }

    /// The same with a factor on the tolerances in lifetime estimates.
    pub(super) const fn loosened(self, slack: f64) -> Self {
        Self { slack, ..self }
    }

    /// Compares one body with its track. If the track no longer holds, replaces it and returns the update.
    ///
    /// `observed`: the position of the body among the observations, and its observation.
    pub(super) fn update(
        &self,
        published: &mut PublishedTracks,
        observed: (usize, &Observation),
        parent_candidate: Option<&ObservedParent>,
    ) -> Option<Update> {
        let (_, observation) = observed;
        let slot = published.observed(self.ticks.tick, observation)?;
        let (payload, track) = match observation.activity {
            Activity::Asleep => {
                // If a woken body is still within tolerance of its rest pose, nothing is sent: subscribers see no
                // difference.
                if slot.is_exact_rest() && self.is_within_rest(published, slot, observation) {
                    return None;
                }
                let resting = Track::resting(self.ticks.tick, observation.motion);
                let tracks = published.tracks();
                (self.rest_payload(tracks, slot, observation), resting)
            }
            Activity::Awake => self.correct(published, slot, observed, parent_candidate)?,
        };
        Some(published.replace(observation.id.index(), payload, track))
    }

    /// The need of a body for an update; `None` if its track still holds.
    pub(super) fn need(
        &self,
        published: &PublishedTracks,
        observation: &Observation,
    ) -> Option<Need> {
        let tick = self.ticks.tick;
        let slot = published.observed(tick, observation)?;
        let tracks = published.tracks();
        let predicted_motion = tracks.predicted_motion((observation.id.index(), slot), tick);
        let truth = observation.motion.motion();
        let share = share_used(tracks, slot, &truth, &predicted_motion);
        let age = tick.since(slot.origin())?;
        let moves = slot.predictor() != Predictor::Rest;
        let urgent = age >= TRACK_AGE_MAX && moves;
        let reported = match observation.activity {
            Activity::Asleep => slot.is_exact_rest() && share <= 1.0,
            Activity::Awake => share <= 1.0 && self.features.prefilter,
        };
        (urgent || !reported).then_some(Need { share, urgent })
    }

    /// True if a body is within tolerance of its published rest pose.
    fn is_within_rest(
        &self,
        published: &PublishedTracks,
        slot: &Slot,
        observation: &Observation,
    ) -> bool {
        let (index, tracks) = (observation.id.index(), published.tracks());
        let predicted_motion = tracks.predicted_motion((index, slot), self.ticks.tick);
        let truth = observation.motion.motion();
        share_used(tracks, slot, &truth, &predicted_motion) <= self.closeness(published, index)
    }

    /// The share of its tolerance within which a body is kept.
    fn closeness(&self, published: &PublishedTracks, index: u32) -> f64 {
        let predicted_after =
            self.features.mode_decision && self.ticks.history.lookahead() > Ticks::ZERO;
        if predicted_after && published.has_children(index) {
            PARENT_TOLERANCE_SHARE
        } else {
            1.0
        }
    }

    /// The payload that puts a body to rest at the engine's exact pose.
    fn rest_payload(
        &self,
        tracks: &Tracks,
        slot: &Slot,
        observation: &Observation,
    ) -> UpdatePayload {
        let (tick, track) = (self.ticks.tick, slot.track());
        let since = tick.since(track.origin);
        let fresh = since.is_some_and(|since| since <= TRACK_AGE_MAX);
        let age = tracks.age(&track, tick);
        let age = age.filter(|age| *age > Age::new(0));
        let free =
            track.parent.is_none() && self.features.residuals && self.features.rest_corrections;
        let still = track.predictor == Predictor::Rest;
        let rest_correction = age.filter(|_| free && (still || fresh));
        let rest_correction = rest_correction.and_then(|age| {
            let predicted = tracks.predicted_motion((observation.id.index(), slot), tick);
            let rest_correction = RestCorrection::of(&observation.motion, &predicted.pose())?;
            Some(UpdatePayload::Resting {
                age,
                rest_correction,
            })
        });
        rest_correction.unwrap_or_else(|| {
            UpdatePayload::Keyframe(Keyframe::of(&Track::resting(tick, observation.motion)))
        })
    }

    /// The update of an awake body, or `None` while its track holds.
    fn correct(
        &self,
        published: &PublishedTracks,
        slot: &Slot,
        (place, observation): (usize, &Observation),
        parent_candidate: Option<&ObservedParent>,
    ) -> Option<(UpdatePayload, Track)> {
        let (tick, tracks) = (self.ticks.tick, published.tracks());
        let truth = observation.motion.motion();
        let track = slot.track();
        let body = (observation.id.index(), slot);
        let framed = tracks.framed(body, &track, tick);
        let parent = tracks.parent(&track);
        let predicted_motion = match (parent, parent_candidate) {
            (None, _) => framed,
            (Some((index, _)), Some(observed)) if observed.index == index => {
                attached_motion(&observed.predicted_motion, &framed.pose())
            }
            (Some(parent), _) => {
                let parent = tracks.framed(parent, &parent.1.track(), tick);
                attached_motion(&parent, &framed.pose())
            }
        };
        let age = tick.since(track.origin)?;
        let moves = track.predictor != Predictor::Rest;
        let orphaned = track.parent.is_some() && parent.is_none();
        let expired = (age >= TRACK_AGE_MAX && moves) || orphaned || !self.features.prefilter;
        let used = share_used(tracks, slot, &truth, &predicted_motion);
        let closeness = self.closeness(published, observation.id.index());
        if !expired && used <= closeness {
            return None;
        }
        let observed = ObservationWindow::of(&self.ticks, observation.id, place);
        let ahead = Ahead::of(&self.ticks, observation.id, place);
        let decision = ModeDecision::new(Context {
            tracks,
            features: self.features,
            slack: self.slack * closeness,
        });
        let stride = observed.stride;
        let subject = Subject {
            index: observation.id.index(),
            slot,
            track: &track,
            tick,
            truth: &truth,
            predicted_motion: &predicted_motion,
            framed: &framed,
            velocities: observed.velocities,
            past: &observed.past,
            stride,
            ahead: ahead.as_ref().map_or(&[], Ahead::motions),
            ends: ahead.as_ref().is_some_and(|ahead| ahead.ends),
            parent: parent_candidate.and_then(|observed| possible_parent(tracks, observed, stride)),
        };
        let chosen = decision.decide(&subject);
        if chosen.is_none() && !expired && used <= 1.0 {
            // A correction can keep a parent no closer than its grid, which is not close enough here.
            return None;
        }
        let chosen = chosen.or_else(|| decision.widened().decide(&subject));
        Some(chosen.unwrap_or_else(|| self.keyframe_update(tracks, slot, observation, &truth)))
    }

    /// A motion that needs no prediction: on the grid, or exact if the grid is too coarse for the tolerance, as for a
    /// body of a hundred metres.
    fn keyframe_update(
        &self,
        tracks: &Tracks,
        slot: &Slot,
        observation: &Observation,
        truth: &Motion,
    ) -> (UpdatePayload, Track) {
        let (tick, grid) = (self.ticks.tick, tracks.grid(slot));
        let falls = self.features.ballistic && tracks.gravity(slot, tick) != glam::DVec3::ZERO;
        let predictor = match (falls, slot.is_torque_free() && self.features.torque_free) {
            (true, true) => Predictor::BallisticTorqueFree,
            (true, false) => Predictor::Ballistic,
            (false, true) => Predictor::TorqueFree,
            (false, false) => Predictor::Uniform,
        };
        let quantised = QuantisedState::of(truth, grid);
        let on_grid = quantised.motion(grid);
        let keyframe = Keyframe {
            predictor,
            anchor: if share_used(tracks, slot, truth, &on_grid) <= 1.0 {
                Anchor::Quantised(quantised)
            } else {
                Anchor::Exact(observation.motion)
            },
            parent: None,
        };
        (UpdatePayload::Keyframe(keyframe), keyframe.track(tick))
    }
}

/// The share of its tolerance that a body's prediction uses.
fn share_used(tracks: &Tracks, slot: &Slot, truth: &Motion, predicted_motion: &Motion) -> f64 {
    share(
        &truth.pose(),
        &predicted_motion.pose(),
        tracks.tolerance_of(slot),
        tracks.radius(slot),
    )
}

/// The possible parent of another body; `stride` is the publish interval of that body's last observations.
fn possible_parent<'s>(
    tracks: &'s Tracks,
    observed: &'s ObservedParent,
    stride: Ticks,
) -> Option<Parent<'s>> {
    let ObservedParent {
        index,
        truth,
        predicted_motion,
        past,
        stride: of_parent,
        ahead,
    } = observed;
    Some(Parent {
        index: *index,
        slot: tracks.slot(*index)?,
        truth,
        predicted_motion,
        past: (*of_parent == stride).then_some(past),
        ahead: ahead.as_ref().map_or(&[], Ahead::motions),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PublishSchedule;
    use crate::stream::observation_history::ObservationHistory;
    use crate::stream::stream_config::StreamConfig;
    use crate::stream::tracks::PredictionParameters;
    use proptest::array::uniform3;
    use proptest::prelude::*;
    use rhumb_reckoning::{BodyId, BodyState, Metres, Tick};

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
