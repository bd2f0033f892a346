//! The check of one body against its published track, and its update.
//!
//! Combines the published tracks, which a converged subscriber holds too, with the mode decision. Invariants: a new
//! track is within the tolerance of the observed state, grid error included; the numbers of children are those of the
//! tracks' parents.
//!
//! The bodies that others are or may be attached to are noted in buffers that are reused from tick to tick. Invariants:
//! candidates, the largest moving bodies of a tick, are sorted by radius, the largest first. The bodies that have children
//! are few, so they are kept in a short list that rises by index, in which no count is zero.

use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Motion, Predictor, QuantisedState, RestCorrection, TRACK_AGE_MAX,
    Tick, Ticks, Track, attached_motion,
};

use super::update_queue::Need;
use crate::packet::{Age, Keyframe, RefreshRecord, Update, UpdatePayload};
use crate::stream::aliases::{AliasMap, AliasTable};
use crate::stream::mode_decision::{Context, ModeDecision, Parent, Subject, share};
use crate::stream::observation_history::{
    Activity, Ahead, Observation, ObservationWindow, ObservedTicks,
};
use crate::stream::tracks::{PredictionParameters, Slot, Tracks};
use crate::stream::{Features, StreamConfig};

/// With lookahead, a parent is kept within this share of its tolerance, because its error adds to that of its children.
const PARENT_TOLERANCE_SHARE: f64 = 0.5;

/// The checks of a tick.
#[derive(Clone, Copy, Debug)]
pub(super) struct BodyCheck<'h> {
    ticks: ObservedTicks<'h>,
    features: Features,
    /// The factor on tolerances in lifetime estimates: above one if the budget does not suffice.
    slack: f64,
    /// The bodies whose tracks did not hold at a tick since the last published one, in order.
    strayed: &'h [BodyId],
}

impl<'h> BodyCheck<'h> {
    /// Checks with the usual tolerances.
    pub(super) const fn new(ticks: ObservedTicks<'h>, features: Features) -> Self {
        Self {
            ticks,
            features,
            slack: 1.0,
            strayed: &[],
        }
    }

    /// The same, and replaces the tracks of these bodies in any case; they are in order.
    pub(super) const fn after_straying(self, strayed: &'h [BodyId]) -> Self {
        Self { strayed, ..self }
    }

    /// True if a body left this track. One that a scene event has placed since is another: no update is as old as that.
    fn has_strayed(&self, id: BodyId, slot: &Slot) -> bool {
        slot.origin() < self.ticks.tick && self.strayed.binary_search(&id).is_ok()
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
                if slot.is_exact_rest()
                    && !self.has_strayed(observation.id, slot)
                    && self.is_within_rest(published, slot, observation)
                {
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
        let strayed = self.has_strayed(observation.id, slot);
        let expired =
            (age >= TRACK_AGE_MAX && moves) || orphaned || strayed || !self.features.prefilter;
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
    fn replace(&mut self, index: u32, payload: UpdatePayload, track: Track) -> Update {
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

    /// True if any body is attached to another.
    pub(super) fn has_parents(&self) -> bool {
        !self.child_counts.counts.is_empty()
    }

    /// The slot of a body observed at a tick. None if it came later, or if another body has the index.
    #[inline]
    pub(super) fn observed(&self, tick: Tick, observation: &Observation) -> Option<&Slot> {
        let slot = self.tracks.slot(observation.id.index())?;
        let there = slot.id(observation.id.index()) == observation.id;
        (there && slot.origin() <= tick).then_some(slot)
    }

    /// True if an observed body is out of tolerance of its track.
    pub(super) fn has_strayed(&self, tick: Tick, observation: &Observation) -> bool {
        self.observed(tick, observation).is_some_and(|slot| {
            let body = (observation.id.index(), slot);
            let predicted = self.tracks.predicted_motion(body, tick);
            share_used(&self.tracks, slot, &observation.motion.motion(), &predicted) > 1.0
        })
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

/// The number of parent candidates at one tick: the largest moving bodies.
const PARENT_CANDIDATES_MAX: usize = 16;
/// A parent is larger than its child by this factor at least.
pub(super) const PARENT_SIZE_RATIO: f64 = 1.2;
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
struct ChildCounts {
    counts: Vec<(u32, u32)>,
}

impl ChildCounts {
    /// Moves a child from one parent to another.
    fn move_child(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
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
mod tests;
