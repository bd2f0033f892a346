//! Compares truth with what was said; says what would break the tolerance.
//!
//! Knows nothing of who listens: what it says is encoded once for all. Invariant: after `publish`, every observed body
//! is within the tolerance of its track, grid error included.

mod holding;
mod islands;
mod packing;
mod repairing;
mod sight;
mod spending;
mod surveying;

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{
    Anchor, BodyId, HORIZON, Integrator, Motion, Predictor, Settling, Snapped, Tick, Tolerance,
    Track,
};

use super::choose::{Chooser, Holder, Subject, share};
use super::features::Features;
use super::history::History;
use super::observation::{Activity, Observation};
use super::parities::Parities;
use super::seats::Usher;
use super::start::StreamStart;
use super::tracks::{Manner, Slot, Tracks};
use super::witness::Witness;
use crate::packet::{Age, Excess, Low16, Saying, StreamId, TrackSaying, Update, Vouch};
use crate::room::push;
use holding::Large;
use repairing::Namings;
use sight::Sight;
pub use spending::InArrears;
use spending::Spending;
use surveying::Survey;

/// What a publisher said so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates said.
    pub updates: u64,
    /// Packets, repairs and vouches aside.
    pub packets: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Observations that were held against tracks: a body that sleeps on is not among them.
    pub looked: u64,
    /// Seats that were looked at, for bodies that were silent for long: those where somebody sits, and some next to them.
    pub seats: u64,
    /// Bodies that were not told of though they were off, for want of budget, each counted at every tick.
    pub withheld: u64,
}

/// What a stream is, at its source.
#[derive(Clone, Copy, Debug)]
pub struct StreamTerms {
    /// Its promise.
    pub tolerance: Tolerance,
    /// How the scene steps.
    pub integrator: Integrator,
    /// The multiples of this number are the ticks that it is said of.
    pub every: NonZeroU32,
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
            every: self.every,
            gravity: self.gravity,
            tick,
            next: 0,
            notices: 0,
        }
    }
}

/// One reckoned stream at its source.
#[derive(Debug)]
pub struct Publisher {
    stream: StreamId,
    tracks: Tracks,
    features: Features,
    history: History,
    parities: Parities,
    tick: Tick,
    usher: Usher,
    /// Who holds others, and how many, in order of index.
    burdens: Vec<(u32, u32)>,
    namings: Namings,
    updates: Vec<Update>,
    /// Who came to rest at this tick: packets still name them by their seats.
    leaving: Vec<u32>,
    /// What the look at a tick found; none while it is made use of.
    survey: Option<Box<Survey>>,
    /// What it may take, if that is limited, and who waits.
    spending: Option<Box<Spending>>,
    /// Factor on all tolerances that a budget asks for at present; one without.
    slack: f64,
    statistics: PublisherStatistics,
}

impl Publisher {
    /// A stream without bodies.
    #[must_use]
    pub fn new(stream: StreamId, terms: &StreamTerms, tick: Tick) -> Self {
        Self {
            stream,
            tracks: Tracks::new(
                terms.tolerance,
                terms.integrator,
                terms.every,
                terms.gravity,
            ),
            features: terms.features,
            history: History::default(),
            parities: Parities::default(),
            tick,
            usher: Usher::default(),
            burdens: Vec::new(),
            namings: Namings::default(),
            updates: Vec::new(),
            leaving: Vec::new(),
            survey: Some(Box::new(Survey::new(terms.tolerance, terms.integrator))),
            spending: None,
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

    /// A body has come into the scene, and every listener is told its first track by a notice.
    ///
    /// Returns `false` when the table has no room, which the scene's own limits prevent.
    #[must_use]
    pub fn place(&mut self, id: BodyId, manner: &Manner, track: Track) -> bool {
        self.tracks.place(id, manner, track, None)
    }

    /// A body has left the scene. What it held is said anew at the next tick.
    pub fn remove(&mut self, id: BodyId) {
        let held_by = self.tracks.slot(id.index()).and_then(Slot::carrier);
        if self.tracks.remove(id) {
            self.usher.leave(id.index());
            self.shift_burden(held_by, None);
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

    /// The seat of a body, if it has one: what a late listener must be told too.
    #[must_use]
    pub fn seat(&self, id: BodyId) -> Option<u32> {
        self.usher.seats().of(id.index())
    }

    /// The number of the next packet.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.history.next()
    }

    /// The tick up to which everything was said.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// What it believes.
    pub(super) const fn table(&self) -> &Tracks {
        &self.tracks
    }

    /// Says what must be said of what was witnessed and appends the datagrams to `out`; none when every track still
    /// holds, or nothing is spoken of now.
    ///
    /// `notices`: how many the scene has given, up to the newest tick that was witnessed.
    pub fn publish(&mut self, witness: &Witness, notices: u64, out: &mut Vec<Bytes>) {
        // A stream that began after that tick has told it already.
        let Some(tick) = witness.present().filter(|tick| *tick > self.tick) else {
            return;
        };
        let before = core::mem::replace(&mut self.tick, tick);
        if let Some(spending) = self.spending.take() {
            return self.publish_within(spending, witness, before, notices, out);
        }
        let observations = witness.at(tick).unwrap_or_default();
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.statistics.seats += self.usher.sweep(tick);
        let mut survey = self.survey.take().expect("no look is going on");
        self.survey(tick, observations, &mut survey);
        // What may hold others is spoken of first, so that what it holds is judged by where it is said to be.
        let mut say = |update: Option<Update>| {
            if let Some(update) = update {
                push(&mut updates, update);
            }
        };
        for Large { place, .. } in &survey.holders {
            say(self.judge(witness, tick, (*place, &observations[*place]), None));
        }
        self.survey_burdened(observations, &mut survey);
        for place in &survey.burdened {
            let place = *place as usize;
            let seen = (place, &observations[place]);
            say(self.judge(witness, tick, seen, None));
        }
        for place in &survey.doubtful {
            if survey.is_before(*place) {
                continue;
            }
            let place = *place as usize;
            let seen = (place, &observations[place]);
            let holder = self.holder_of(seen.1, &survey.holders, observations);
            say(self.judge(witness, tick, seen, holder));
        }
        self.survey = Some(survey);
        self.say(tick, &mut updates, notices, out);
        self.updates = updates;
    }

    /// Says what was judged to be said at a tick.
    fn say(&mut self, tick: Tick, updates: &mut [Update], notices: u64, out: &mut Vec<Bytes>) {
        self.pack(tick, updates, notices, out);
        for index in self.leaving.drain(..) {
            self.usher.leave(index);
        }
        self.namings.end_tick(self.history.next());
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
    fn judge(
        &mut self,
        witness: &Witness,
        tick: Tick,
        seen: (usize, &Observation),
        holder: Option<usize>,
    ) -> Option<Update> {
        let (_, observation) = seen;
        let index = observation.id.index();
        let slot = self.seen_slot(observation)?;
        let (saying, track) = match observation.activity {
            Activity::Asleep => {
                // Who was woken and lies within tolerance of where it lay never came out of rest for who watches.
                if slot.is_verbatim_rest() && self.lies(witness, tick, slot, observation) {
                    return None;
                }
                let resting = Track::resting(tick, observation.motion);
                (self.settle(tick, slot, observation), resting)
            }
            Activity::Awake => self.correct(witness, tick, slot, seen, holder)?,
        };
        let before = slot.carrier();
        self.tracks.set_track(index, track);
        let saying = self.readable(index, before, saying, &track);
        if before != track.carrier {
            self.shift_burden(before, track.carrier);
        }
        let (seat, taken) = self.usher.seat(index, tick);
        if track.is_verbatim_rest() {
            self.leaving.push(index);
        }
        let named = taken || matches!(saying, Saying::Whole(_));
        Some(Update {
            seat,
            body: named.then_some(index),
            saying,
        })
    }

    /// Whether a body is within tolerance of where it is said to lie.
    fn lies(&self, witness: &Witness, tick: Tick, slot: &Slot, observation: &Observation) -> bool {
        let index = observation.id.index();
        let used = share(
            &observation.motion.motion().pose(),
            &self.tracks.believed((index, slot), tick).pose(),
            self.tracks.tolerance_of(slot),
            self.tracks.radius(slot),
        );
        used <= self.closeness(witness, index)
    }

    /// What says that a body rests where the engine has it, to the bit.
    fn settle(&self, tick: Tick, slot: &Slot, observation: &Observation) -> Saying {
        let index = observation.id.index();
        let track = slot.track();
        let since = tick.since(track.origin);
        let fresh = since.is_some_and(|since| since <= HORIZON);
        let age = self.tracks.age(&track, tick);
        let age = age.filter(|age| *age > Age::new(0));
        let free = track.carrier.is_none() && self.features.residuals;
        let still = track.predictor == Predictor::Rest;
        let settling = age.filter(|_| free && (still || fresh));
        let settling = settling.and_then(|age| {
            let predicted = self.tracks.believed((index, slot), tick);
            let settling = Settling::of(&observation.motion, &predicted.pose())?;
            Some(Saying::Settled { age, settling })
        });
        settling.unwrap_or_else(|| {
            Saying::Whole(TrackSaying::of(&Track::resting(tick, observation.motion)))
        })
    }

    /// What to say of a body that is awake, or `None` while its track holds.
    fn correct(
        &self,
        witness: &Witness,
        tick: Tick,
        slot: &Slot,
        (place, observation): (usize, &Observation),
        holder: Option<usize>,
    ) -> Option<(Saying, Track)> {
        let truth = observation.motion.motion();
        let track = slot.track();
        let believed = self.tracks.believed((observation.id.index(), slot), tick);
        let tolerance = self.tracks.tolerance_of(slot);
        let age = tick.since(track.origin)?;
        let moves = track.predictor != Predictor::Rest;
        let orphaned = track.carrier.is_some() && self.tracks.carrier(&track).is_none();
        let expired = (age >= HORIZON && moves) || orphaned || !self.features.gate;
        let used = share(
            &truth.pose(),
            &believed.pose(),
            tolerance,
            self.tracks.radius(slot),
        );
        let closeness = self.closeness(witness, observation.id.index());
        if !expired && used <= closeness {
            return None;
        }
        let seen = Sight::of(witness, observation.id, tick, place);
        let held_by = holder.and_then(|place| {
            let other = witness.at(tick)?.get(place)?;
            Some((other, Sight::of(witness, other.id, tick, place)))
        });
        let chooser = Chooser {
            tracks: &self.tracks,
            features: self.features,
            slack: self.slack * closeness,
        };
        let stride = seen.stride;
        let subject = Subject {
            index: observation.id.index(),
            slot,
            track: &track,
            tick,
            truth,
            believed,
            last: seen.last,
            past: seen.past,
            stride,
            ahead: seen.ahead(),
            ends: seen.ends(),
            holder: held_by.as_ref().and_then(|(other, seen)| {
                Some(Holder {
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
        let chosen = chooser.foresee(&subject).or_else(|| {
            let choice = chooser.choose(&subject)?;
            Some((choice.saying, choice.track))
        });
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
    ) -> (Saying, Track) {
        let grid = self.tracks.grid(slot);
        let falls = self.features.ballistic && self.tracks.gravity(slot, tick) != glam::DVec3::ZERO;
        let predictor = match (falls, slot.tumbles() && self.features.tumbling) {
            (true, true) => Predictor::Thrown,
            (true, false) => Predictor::Ballistic,
            (false, true) => Predictor::Tumbling,
            (false, false) => Predictor::Uniform,
        };
        let snapped = Snapped::of(truth, grid);
        let said = snapped.motion(grid);
        let used = share(
            &truth.pose(),
            &said.pose(),
            self.tracks.tolerance_of(slot),
            self.tracks.radius(slot),
        );
        let whole = TrackSaying {
            predictor,
            anchor: if used <= 1.0 {
                Anchor::Snapped(snapped)
            } else {
                Anchor::Verbatim(observation.motion)
            },
            carrier: None,
        };
        (Saying::Whole(whole), whole.track(tick))
    }

    /// The datagram that vouches for the silence since the last packet.
    #[must_use]
    pub fn vouch(&self, notices: u64) -> Bytes {
        let vouch = Vouch {
            next: Low16::of(self.history.next()),
            tick: Low16::of(self.tick.value()),
            notices: Low16::of(notices),
        };
        Bytes::from(match self.excess() {
            Excess::NONE => vouch.encode(self.stream),
            excess => vouch.encode_in_arrears(self.stream, excess),
        })
    }
}
