//! Compares truth with what was said; says what would break the tolerance.
//!
//! Knows nothing of who listens: what it says is encoded once for all. Invariant: after `publish`, every observed body
//! is within the tolerance of its track, grid error included.

mod attaching;
mod budget_state;
mod islands;
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
    Tick, Ticks, Tolerance, Track,
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
    Age, Checksums, ErrorScale, Keyframe, Low16, StreamId, Update, UpdatePayload, Watermark,
};
use attaching::LargeBody;
use budget_state::BudgetState;
pub use budget_state::OverBudget;
use scan::ObservationScan;
use window::ObservationWindow;

/// What a publisher said so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates said.
    pub updates: u64,
    /// Packets, refreshes and watermarks aside.
    pub packets: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Observations that were held against tracks: a body that sleeps on is not among them.
    pub looked: u64,
    /// ReceivedAliases that were looked at, for bodies that were silent for long: those where somebody sits, and some next to them.
    pub aliases: u64,
    /// Bodies that were not told of though they were off, for want of budget, each counted at every tick.
    pub over_budget: u64,
}

/// What a stream is, at its source.
#[derive(Clone, Copy, Debug)]
pub struct StreamTerms {
    /// Its promise.
    pub tolerance: Tolerance,
    /// How the scene steps.
    pub integrator: Integrator,
    /// The multiples of this number are the ticks that it is said of.
    pub publish_interval: NonZeroU32,
    /// What pulls now, m/s².
    pub gravity: Vec3,
    /// What its publisher may use.
    pub features: Features,
}

impl StreamTerms {
    /// Where a subscriber begins that hears the stream from the beginning, which is at this tick.
    #[must_use]
    pub const fn start(&self, stream: StreamId, tick: Tick) -> StreamStart {
        StreamStart {
            stream,
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

/// One reckoned stream at its source.
#[derive(Debug)]
pub struct Publisher {
    stream: StreamId,
    tracks: Tracks,
    features: Features,
    sent_packets: SentPackets,
    repair_symbols: FecEncoder,
    tick: Tick,
    alias_table: AliasTable,
    /// Who holds others, and how many, in order of index.
    child_counts: Vec<(u32, u32)>,
    /// Pairs of parent and body: this tick's updates of the bodies build on tracks of the parents.
    attached: Vec<(u32, u32)>,
    updates: Vec<Update>,
    /// Who came to rest at this tick: packets still name them by their aliases.
    resting_bodies: Vec<u32>,
    /// What the look at a tick found; none while it is made use of.
    scan: Option<Box<ObservationScan>>,
    /// What it may take, if that is limited, and who waits.
    budget_state: Option<Box<BudgetState>>,
    /// Factor on all tolerances that a budget asks for at present; one without.
    slack: f64,
    statistics: PublisherStatistics,
}

impl Publisher {
    /// A stream without bodies.
    #[must_use]
    pub fn new(stream: StreamId, config: &StreamTerms, tick: Tick) -> Self {
        Self {
            stream,
            tracks: Tracks::new(
                config.tolerance,
                config.integrator,
                config.publish_interval,
                config.gravity,
            ),
            features: config.features,
            sent_packets: SentPackets::default(),
            repair_symbols: FecEncoder::default(),
            tick,
            alias_table: AliasTable::default(),
            child_counts: Vec::new(),
            attached: Vec::new(),
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

    /// Its name.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.stream
    }

    /// Its promise.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.tracks.tolerance()
    }

    /// What it said so far.
    #[must_use]
    pub const fn statistics(&self) -> PublisherStatistics {
        self.statistics
    }

    /// A body has come into the scene, and every listener is told its first track by a scene_event.
    ///
    /// Returns `false` when the table has no room, which the scene's own limits prevent.
    #[must_use]
    pub fn place(&mut self, id: BodyId, parameters: &PredictionParameters, track: Track) -> bool {
        self.tracks.place(id, parameters, track, None)
    }

    /// A body has left the scene. What it held is said anew at the next tick.
    pub fn remove(&mut self, id: BodyId) {
        let attached_to = self.tracks.slot(id.index()).and_then(Slot::parent);
        if self.tracks.remove(id) {
            self.alias_table.release(id.index());
            self.move_child(attached_to, None);
        }
    }

    /// Another gravity pulls from this tick on.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
    }

    /// What pulled from which tick on, as far as tracks refer to it: what a late listener must be told before the tracks.
    pub fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.tracks.gravity_changes()
    }

    /// Every body's track, in order of index: what a late listener must be told.
    pub fn tracks(&self) -> impl Iterator<Item = (BodyId, Track)> {
        self.tracks
            .iter()
            .map(|(index, slot)| (slot.id(index), slot.track()))
    }

    /// The alias of a body, if it has one: what a late listener must be told too.
    #[must_use]
    pub fn alias(&self, id: BodyId) -> Option<u32> {
        self.alias_table.aliases().of(id.index())
    }

    /// The number of the next packet.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.sent_packets.next()
    }

    /// The tick up to which everything was said.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// Keyframe ticks in a second of its scene, at least one.
    #[must_use]
    pub fn second(&self) -> Ticks {
        second(self.tracks.integrator().rate)
    }

    /// Says what must be said of what was observed and appends the datagrams to `out`; none when every track still
    /// holds, or nothing is spoken of now.
    ///
    /// `scene_events`: how many the scene has given, up to the newest tick that was observed.
    pub fn publish(
        &mut self,
        observation_history: &ObservationHistory,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        // A stream that began after that tick has told it already.
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
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.statistics.aliases += self.alias_table.release_idle_aliases(tick);
        let mut scan = self.scan.take().expect("no look is going on");
        self.scan(tick, observations, &mut scan);
        // What may hold others is spoken of first, so that what it holds is judged by where it is said to be.
        let mut say = |update: Option<Update>| {
            if let Some(update) = update {
                push(&mut updates, update);
            }
        };
        for LargeBody { place, .. } in &scan.parent_candidates {
            say(self.check(
                observation_history,
                tick,
                (*place, &observations[*place]),
                None,
            ));
        }
        self.scan_other_parents(observations, &mut scan);
        for place in &scan.other_parents {
            let place = *place as usize;
            let seen = (place, &observations[place]);
            say(self.check(observation_history, tick, seen, None));
        }
        for place in &scan.undecided {
            if scan.is_before(*place) {
                continue;
            }
            let place = *place as usize;
            let seen = (place, &observations[place]);
            let parent_candidate =
                self.parent_candidate_of(seen.1, &scan.parent_candidates, observations);
            say(self.check(observation_history, tick, seen, parent_candidate));
        }
        self.scan = Some(scan);
        self.say(tick, &mut updates, scene_events, out);
        self.updates = updates;
    }

    /// Says what was judged to be said at a tick.
    fn say(&mut self, tick: Tick, updates: &mut [Update], scene_events: u64, out: &mut Vec<Bytes>) {
        self.pack(tick, updates, scene_events, out);
        for index in self.resting_bodies.drain(..) {
            self.alias_table.release(index);
        }
        self.attached.clear();
    }

    /// The slot of a body that was seen at the present tick: not of one that came later, or has the index of one that went.
    fn seen_slot(&self, observation: &Observation) -> Option<&Slot> {
        let slot = self.tracks.slot(observation.id.index())?;
        let there = slot.id(observation.id.index()) == observation.id;
        (there && slot.origin() <= self.tick).then_some(slot)
    }

    /// Compares one body with its track; when the track no longer holds, replaces it and returns what says so.
    ///
    /// `seen`: what was seen of it, and its place about there among those that were seen.
    fn check(
        &mut self,
        observation_history: &ObservationHistory,
        tick: Tick,
        seen: (usize, &Observation),
        parent_candidate: Option<usize>,
    ) -> Option<Update> {
        let (_, observation) = seen;
        let index = observation.id.index();
        let slot = self.seen_slot(observation)?;
        let (payload, track) = match observation.activity {
            Activity::Asleep => {
                // Who was woken and is_within_rest within tolerance of where it lay never came out of rest for who watches.
                if slot.is_exact_rest()
                    && self.is_within_rest(observation_history, tick, slot, observation)
                {
                    return None;
                }
                let resting = Track::resting(tick, observation.motion);
                (self.rest_payload(tick, slot, observation), resting)
            }
            Activity::Awake => {
                self.correct(observation_history, tick, slot, seen, parent_candidate)?
            }
        };
        let before = slot.parent();
        self.tracks.set_track(index, track);
        if let Some(parent) = track.parent.or(before)
            && payload.names_parent()
        {
            self.attached.push((parent.index(), index));
        }
        if before != track.parent {
            self.move_child(before, track.parent);
        }
        let (alias, taken) = self.alias_table.alias(index, tick);
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

    /// Whether a body is within tolerance of where it is said to lie.
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

    /// What says that a body rests where the engine has it, to the bit.
    fn rest_payload(&self, tick: Tick, slot: &Slot, observation: &Observation) -> UpdatePayload {
        let index = observation.id.index();
        let track = slot.track();
        let since = tick.since(track.origin);
        let fresh = since.is_some_and(|since| since <= TRACK_AGE_MAX);
        let age = self.tracks.age(&track, tick);
        let age = age.filter(|age| *age > Age::new(0));
        let free = track.parent.is_none() && self.features.residuals;
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

    /// What to say of a body that is awake, or `None` while its track holds.
    fn correct(
        &self,
        observation_history: &ObservationHistory,
        tick: Tick,
        slot: &Slot,
        (place, observation): (usize, &Observation),
        parent_candidate: Option<usize>,
    ) -> Option<(UpdatePayload, Track)> {
        let truth = observation.motion.motion();
        let track = slot.track();
        let predicted_motion = self
            .tracks
            .predicted_motion((observation.id.index(), slot), tick);
        let tolerance = self.tracks.tolerance_of(slot);
        let age = tick.since(track.origin)?;
        let moves = track.predictor != Predictor::Rest;
        let orphaned = track.parent.is_some() && self.tracks.parent(&track).is_none();
        let expired = (age >= TRACK_AGE_MAX && moves) || orphaned || !self.features.prefilter;
        let used = share(
            &truth.pose(),
            &predicted_motion.pose(),
            tolerance,
            self.tracks.radius(slot),
        );
        let closeness = self.closeness(observation_history, observation.id.index());
        if !expired && used <= closeness {
            return None;
        }
        let seen = ObservationWindow::of(observation_history, observation.id, tick, place);
        let attached_to = parent_candidate.and_then(|place| {
            let other = observation_history.at(tick)?.get(place)?;
            Some((
                other,
                ObservationWindow::of(observation_history, other.id, tick, place),
            ))
        });
        let decision = ModeDecision::new(Context {
            tracks: &self.tracks,
            features: self.features,
            slack: self.slack * closeness,
        });
        let stride = seen.stride;
        let subject = Subject {
            index: observation.id.index(),
            slot,
            track: &track,
            tick,
            truth,
            predicted_motion,
            last: seen.last,
            past: seen.past,
            stride,
            ahead: seen.ahead(),
            ends: seen.ends(),
            parent: attached_to.as_ref().and_then(|(other, seen)| {
                Some(Parent {
                    index: other.id.index(),
                    slot: self.tracks.slot(other.id.index())?,
                    truth: other.motion.motion(),
                    past: if seen.stride == stride {
                        seen.past
                    } else {
                        [None; 2]
                    },
                    ahead: seen.ahead(),
                })
            }),
        };
        let chosen = decision.decide(&subject);
        if chosen.is_none() && !expired && used <= 1.0 {
            // No correction keeps a parent closer than its grid is fine.
            return None;
        }
        let chosen = chosen.or_else(|| decision.widened().decide(&subject));
        Some(chosen.unwrap_or_else(|| self.anew(tick, slot, observation, &truth)))
    }

    /// A motion said alone: on the grid, or to the bit where the grid is too coarse for the promise (a body of a
    /// hundred metres, say).
    fn anew(
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
        let said = quantised.motion(grid);
        let used = share(
            &truth.pose(),
            &said.pose(),
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

    /// The checksum over all tracks; a converged subscriber has the same.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.tracks.state_checksum().value()
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

    /// The datagram that watermarks for the silence since the last packet.
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
