//! The publisher of a reckoned stream: encodes updates for its subscribers.
//!
//! Compares observations with its tracks and sends an update for each body out of tolerance. Knows no receivers: an
//! update is encoded once for all. Invariant: after `publish`, every observed body is within the tolerance of its
//! track, grid error included.

mod attaching;
mod budget_state;
mod budgeting;
mod large_body;
mod observation_scan;
mod packing;
mod refreshing;
mod scan;
mod window;

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{
    Anchor, BodyId, Integrator, Motion, Predictor, QuantisedState, RestCorrection, TRACK_AGE_MAX,
    Tick, Ticks, Tolerance, Track, attached_motion,
};

use super::aliases::AliasTable;
use super::features::Features;
use super::fec_encoder::FecEncoder;
use super::mode_decision::{Context, ModeDecision, Parent, Subject, share};
use super::observation::{Activity, Observation};
use super::observation_history::ObservationHistory;
use super::sent_packets::SentPackets;
use super::start::StreamStart;
use super::tracks::{PredictionParameters, Slot, Tracks};
use super::watermark::second;
use crate::capacity::push;
use crate::packet::{
    Age, Checksums, ErrorScale, Keyframe, LargestPacket, Low16, StreamId, Update, UpdatePayload,
    Watermark,
};
use budget_state::BudgetState;
pub use budget_state::OverBudget;
use large_body::{LargeBody, ObservedParent};
use observation_scan::ObservationScan;
use window::{Ahead, ObservationWindow, ObservedTicks};

/// Counters of a publisher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates sent.
    pub updates: u64,
    /// Packets sent, without refreshes and watermarks.
    pub packets: u64,
    /// Bytes of these packets.
    pub bytes: u64,
    /// Observations compared with tracks. A body that stays asleep has none.
    pub checked: u64,
    /// Bodies out of tolerance without an update, because the budget did not suffice. Counted at every tick.
    pub over_budget: u64,
}

/// The config of a stream.
#[derive(Clone, Copy, Debug)]
pub struct StreamConfig {
    /// The tolerance of every body with the usual scale.
    pub tolerance: Tolerance,
    /// The integrator and rate of the scene.
    pub integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    pub publish_interval: NonZeroU32,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The largest packet that the publisher makes.
    pub largest_packet: LargestPacket,
    /// The features that the publisher may use.
    pub features: Features,
}

impl StreamConfig {
    /// The start of a subscriber that receives the stream from its first tick.
    #[must_use]
    pub const fn start(&self, stream: StreamId, tick: Tick) -> StreamStart {
        StreamStart {
            stream,
            largest_packet: self.largest_packet,
            tolerance: self.tolerance,
            integrator: self.integrator,
            publish_interval: self.publish_interval,
            gravity: self.gravity,
            tick,
            next: 0,
            scene_events: 0,
        }
    }
}

/// The publisher of one reckoned stream.
#[derive(Debug)]
pub struct Publisher {
    stream: StreamId,
    tracks: Tracks,
    features: Features,
    largest_packet: LargestPacket,
    sent_packets: SentPackets,
    repair_symbols: FecEncoder,
    tick: Tick,
    alias_table: AliasTable,
    /// Parents and their numbers of children, in order of index.
    child_counts: Vec<(u32, u32)>,
    updates: Vec<Update>,
    /// Bodies that came to rest at this tick. Packets of this tick still use their aliases.
    resting_bodies: Vec<u32>,
    /// The buffers of the scan; None while it is in use.
    scan: Option<Box<ObservationScan>>,
    /// The state of the budget and the waiting bodies; None without a budget.
    budget_state: Option<Box<BudgetState>>,
    /// The present factor on all tolerances, raised while the budget does not suffice; otherwise one.
    slack: f64,
    statistics: PublisherStatistics,
}

impl Publisher {
    /// A publisher of a stream without bodies.
    #[must_use]
    pub fn new(stream: StreamId, config: &StreamConfig, tick: Tick) -> Self {
        Self {
            stream,
            tracks: Tracks::new(
                config.tolerance,
                config.integrator,
                config.publish_interval,
                config.gravity,
            ),
            features: config.features,
            largest_packet: config.largest_packet,
            sent_packets: SentPackets::default(),
            repair_symbols: FecEncoder::default(),
            tick,
            alias_table: AliasTable::default(),
            child_counts: Vec::new(),
            updates: Vec::new(),
            resting_bodies: Vec::new(),
            scan: Some(Box::new(ObservationScan::new(
                config.tolerance,
                config.integrator,
            ))),
            budget_state: None,
            slack: 1.0,
            statistics: PublisherStatistics::default(),
        }
    }

    /// The id of the stream.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.stream
    }

    /// The largest packet that it makes.
    #[must_use]
    pub const fn largest_packet(&self) -> LargestPacket {
        self.largest_packet
    }

    /// The tolerance of a body with the usual scale.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.tracks.tolerance()
    }

    /// Counters of everything published so far.
    #[must_use]
    pub const fn statistics(&self) -> PublisherStatistics {
        self.statistics
    }

    /// Places a body that came into the scene or was changed. A scene event carries its track to every receiver.
    ///
    /// Returns `false` if the table is full, which the scene's own limits prevent.
    #[must_use]
    pub fn place(&mut self, id: BodyId, parameters: &PredictionParameters, track: Track) -> bool {
        let attached_to = self.tracks.slot(id.index()).and_then(Slot::parent);
        let placed = self.tracks.place(id, parameters, track, None);
        if placed {
            self.alias_table.release(id.index());
            self.move_child(attached_to, None);
        }
        placed
    }

    /// Removes a body from the scene. Its children are updated at the next tick.
    pub fn remove(&mut self, id: BodyId) {
        let attached_to = self.tracks.slot(id.index()).and_then(Slot::parent);
        if self.tracks.remove(id) {
            self.alias_table.release(id.index());
            self.move_child(attached_to, None);
        }
    }

    /// Changes the gravity from this tick on.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
    }

    /// The gravity and the first tick of each change that a track may refer to. A late receiver needs them before the
    /// tracks.
    pub fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.tracks.gravity_changes()
    }

    /// Every body's track, in order of index, for a late receiver.
    pub fn tracks(&self) -> impl Iterator<Item = (BodyId, Track)> {
        self.tracks
            .iter()
            .map(|(index, slot)| (slot.id(index), slot.track()))
    }

    /// The alias of a body, for a late receiver.
    #[must_use]
    pub fn alias(&self, id: BodyId) -> Option<u32> {
        self.alias_table.aliases().of(id.index())
    }

    /// The number of the next packet.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.sent_packets.next()
    }

    /// The tick up to which everything is published.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// Whole ticks in a second of the scene, at least one.
    #[must_use]
    pub fn second(&self) -> Ticks {
        second(self.tracks.integrator().rate)
    }

    /// Publishes the present tick and appends the datagrams to `out`: none if every track still holds, or if no tick is
    /// due.
    ///
    /// `scene_events`: the scene's number of events up to the newest observed tick.
    pub fn publish(
        &mut self,
        observation_history: &ObservationHistory,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        // A stream that began after that tick has already published it.
        let Some(tick) = observation_history
            .present()
            .filter(|tick| *tick > self.tick)
        else {
            return;
        };
        let before = core::mem::replace(&mut self.tick, tick);
        if let Some(budget_state) = self.budget_state.take() {
            return self.publish_within(
                budget_state,
                observation_history,
                before,
                scene_events,
                out,
            );
        }
        let observations = observation_history.at(tick).unwrap_or_default();
        let ticks = ObservedTicks::around(observation_history, tick);
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.alias_table.begin_tick();
        let mut scan = self.scan.take().expect("no scan is in progress");
        self.scan(tick, observations, &mut scan);
        // Possible parents are checked first, so that a child is compared with its parent's published track.
        let mut emit = |update: Option<Update>| {
            if let Some(update) = update {
                push(&mut updates, update);
            }
        };
        for LargeBody { place, .. } in &scan.parent_candidates {
            emit(self.check(&ticks, (*place, &observations[*place]), None));
        }
        self.scan_other_parents(observations, &mut scan);
        for place in &scan.other_parents {
            let place = *place as usize;
            let observed = (place, &observations[place]);
            emit(self.check(&ticks, observed, None));
        }
        self.observe_parents(&ticks, &mut scan);
        for place in &scan.undecided {
            if scan.is_before(*place) {
                continue;
            }
            let place = *place as usize;
            let observed = (place, &observations[place]);
            let parent_candidate = self.parent_candidate_of(observed.1, &scan);
            emit(self.check(&ticks, observed, parent_candidate));
        }
        self.scan = Some(scan);
        self.encode_updates(tick, &mut updates, scene_events, out);
        self.updates = updates;
    }

    /// Encodes the updates of a tick into datagrams.
    fn encode_updates(
        &mut self,
        tick: Tick,
        updates: &mut [Update],
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        self.pack(tick, updates, scene_events, out);
        for index in self.resting_bodies.drain(..) {
            if self.features.aliases {
                self.alias_table.release(index);
            }
        }
    }

    /// The slot of a body observed at the present tick. None if it came later, or if another body has the index.
    fn observed_slot(&self, observation: &Observation) -> Option<&Slot> {
        let slot = self.tracks.slot(observation.id.index())?;
        let there = slot.id(observation.id.index()) == observation.id;
        (there && slot.origin() <= self.tick).then_some(slot)
    }

    /// Compares one body with its track. If the track no longer holds, replaces it and returns the update.
    ///
    /// `observed`: the position of the body among the observations, and its observation.
    fn check(
        &mut self,
        ticks: &ObservedTicks<'_>,
        observed: (usize, &Observation),
        parent_candidate: Option<&ObservedParent>,
    ) -> Option<Update> {
        let (tick, (_, observation)) = (ticks.tick, observed);
        let index = observation.id.index();
        let slot = self.observed_slot(observation)?;
        let (payload, track) = match observation.activity {
            Activity::Asleep => {
                // If a woken body is still within tolerance of its rest pose, nothing is sent: subscribers see no
                // difference.
                if slot.is_exact_rest()
                    && self.is_within_rest(ticks.history, tick, slot, observation)
                {
                    return None;
                }
                let resting = Track::resting(tick, observation.motion);
                (self.rest_payload(tick, slot, observation), resting)
            }
            Activity::Awake => self.correct(ticks, slot, observed, parent_candidate)?,
        };
        let before = slot.parent();
        self.tracks.set_track(index, track);
        if before != track.parent {
            self.move_child(before, track.parent);
        }
        let (alias, taken) = if self.features.aliases {
            self.alias_table.alias(index)
        } else {
            self.alias_table.alias_of_index(index)
        };
        if track.is_exact_rest() {
            self.resting_bodies.push(index);
        }
        let named = taken || matches!(payload, UpdatePayload::Keyframe(_));
        Some(Update {
            alias,
            body: named.then_some(index),
            payload,
        })
    }

    /// True if a body is within tolerance of its published rest pose.
    fn is_within_rest(
        &self,
        observation_history: &ObservationHistory,
        tick: Tick,
        slot: &Slot,
        observation: &Observation,
    ) -> bool {
        let index = observation.id.index();
        let used = share(
            &observation.motion.motion().pose(),
            &self.tracks.predicted_motion((index, slot), tick).pose(),
            self.tracks.tolerance_of(slot),
            self.tracks.radius(slot),
        );
        used <= self.closeness(observation_history, index)
    }

    /// The payload that puts a body to rest at the engine's exact pose.
    fn rest_payload(&self, tick: Tick, slot: &Slot, observation: &Observation) -> UpdatePayload {
        let index = observation.id.index();
        let track = slot.track();
        let since = tick.since(track.origin);
        let fresh = since.is_some_and(|since| since <= TRACK_AGE_MAX);
        let age = self.tracks.age(&track, tick);
        let age = age.filter(|age| *age > Age::new(0));
        let free =
            track.parent.is_none() && self.features.residuals && self.features.rest_corrections;
        let still = track.predictor == Predictor::Rest;
        let rest_correction = age.filter(|_| free && (still || fresh));
        let rest_correction = rest_correction.and_then(|age| {
            let predicted = self.tracks.predicted_motion((index, slot), tick);
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
        ticks: &ObservedTicks<'_>,
        slot: &Slot,
        (place, observation): (usize, &Observation),
        parent_candidate: Option<&ObservedParent>,
    ) -> Option<(UpdatePayload, Track)> {
        let tick = ticks.tick;
        let truth = observation.motion.motion();
        let track = slot.track();
        let body = (observation.id.index(), slot);
        let framed = self.tracks.framed(body, &track, tick);
        let parent = self.tracks.parent(&track);
        let predicted_motion = match (parent, parent_candidate) {
            (None, _) => framed,
            (Some((index, _)), Some(observed)) if observed.index == index => {
                attached_motion(&observed.predicted_motion, &framed.pose())
            }
            (Some(parent), _) => {
                let parent = self.tracks.framed(parent, &parent.1.track(), tick);
                attached_motion(&parent, &framed.pose())
            }
        };
        let tolerance = self.tracks.tolerance_of(slot);
        let age = tick.since(track.origin)?;
        let moves = track.predictor != Predictor::Rest;
        let orphaned = track.parent.is_some() && parent.is_none();
        let expired = (age >= TRACK_AGE_MAX && moves) || orphaned || !self.features.prefilter;
        let used = share(
            &truth.pose(),
            &predicted_motion.pose(),
            tolerance,
            self.tracks.radius(slot),
        );
        let closeness = self.closeness(ticks.history, observation.id.index());
        if !expired && used <= closeness {
            return None;
        }
        let observed = ObservationWindow::of(ticks, observation.id, place);
        let ahead = Ahead::of(ticks, observation.id, place);
        let decision = ModeDecision::new(Context {
            tracks: &self.tracks,
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
            parent: parent_candidate.and_then(|observed| self.parent(observed, stride)),
        };
        let chosen = decision.decide(&subject);
        if chosen.is_none() && !expired && used <= 1.0 {
            // A correction can keep a parent no closer than its grid, which is not close enough here.
            return None;
        }
        let chosen = chosen.or_else(|| decision.widened().decide(&subject));
        Some(chosen.unwrap_or_else(|| self.keyframe_update(tick, slot, observation, &truth)))
    }

    /// The possible parent of another body; `stride` is the publish interval of that body's last observations.
    fn parent<'s>(&'s self, observed: &'s ObservedParent, stride: Ticks) -> Option<Parent<'s>> {
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
            slot: self.tracks.slot(*index)?,
            truth,
            predicted_motion,
            past: (*of_parent == stride).then_some(past),
            ahead: ahead.as_ref().map_or(&[], Ahead::motions),
        })
    }

    /// A motion that needs no prediction: on the grid, or exact if the grid is too coarse for the tolerance, as for a
    /// body of a hundred metres.
    fn keyframe_update(
        &self,
        tick: Tick,
        slot: &Slot,
        observation: &Observation,
        truth: &Motion,
    ) -> (UpdatePayload, Track) {
        let grid = self.tracks.grid(slot);
        let falls = self.features.ballistic && self.tracks.gravity(slot, tick) != glam::DVec3::ZERO;
        let predictor = match (falls, slot.is_torque_free() && self.features.torque_free) {
            (true, true) => Predictor::BallisticTorqueFree,
            (true, false) => Predictor::Ballistic,
            (false, true) => Predictor::TorqueFree,
            (false, false) => Predictor::Uniform,
        };
        let quantised = QuantisedState::of(truth, grid);
        let on_grid = quantised.motion(grid);
        let used = share(
            &truth.pose(),
            &on_grid.pose(),
            self.tracks.tolerance_of(slot),
            self.tracks.radius(slot),
        );
        let keyframe = Keyframe {
            predictor,
            anchor: if used <= 1.0 {
                Anchor::Quantised(quantised)
            } else {
                Anchor::Exact(observation.motion)
            },
            parent: None,
        };
        (UpdatePayload::Keyframe(keyframe), keyframe.track(tick))
    }

    /// True if checksums are sent.
    pub(super) const fn sends_checksums(&self) -> bool {
        self.features.checksums
    }

    /// The checksum over all tracks; a converged subscriber has the same.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.tracks.state_checksum()
    }

    /// The same, by hashing only the tracks that changed since the last call.
    pub(super) fn settle_checksum(&mut self) -> u64 {
        self.tracks.settle_checksum()
    }

    /// The datagram with the checksum over all tracks. `scene_events`: the scene's number of events so far.
    #[must_use]
    pub fn checksums(&self, scene_events: u64) -> Bytes {
        let checksums = Checksums {
            next: Low16::of(self.sent_packets.next()),
            tick: Low16::of(self.tick.value()),
            scene_events: Low16::of(scene_events),
            sum: self.state_checksum(),
        };
        Bytes::from(checksums.encode(self.stream))
    }

    /// The watermark for the silence since the last packet.
    #[must_use]
    pub fn watermark(&self, scene_events: u64) -> Bytes {
        let watermark = Watermark {
            next: Low16::of(self.sent_packets.next()),
            tick: Low16::of(self.tick.value()),
            scene_events: Low16::of(scene_events),
        };
        Bytes::from(match self.error_scale() {
            ErrorScale::NONE => watermark.encode(self.stream),
            error_scale => watermark.encode_over_budget(self.stream, error_scale),
        })
    }
}
