//! Compares truth with what was said; says what would break the tolerance.
//!
//! Knows nothing of who listens: what it says is encoded once for all. Invariant: after `publish`, every observed body
//! is within the tolerance of its track, grid error included.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{
    Anchor, BodyId, HORIZON, Integrator, Motion, Predictor, Snapped, Tick, Ticks, Tolerance, Track,
};

use super::choose::{Chooser, Holder, Subject, share};
use super::features::Features;
use super::history::History;
use super::observation::{Activity, Observation};
use super::seats::Usher;
use super::tracks::{Manner, Slot, Tracks};
use super::witness::{HINDSIGHT_MAX, Witness};
use crate::limits::{HISTORY_PACKETS, UPDATES_PER_PACKET_MAX};
use crate::packet::{
    Low16, RepairRecord, RepairWriter, Saying, StateWriter, StreamId, Tongue, TrackSaying, Update,
    Vouch,
};

/// What a publisher said so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates said.
    pub updates: u64,
    /// Packets, repairs and vouches aside.
    pub packets: u64,
    /// Their bytes.
    pub bytes: u64,
}

/// What a stream is, at its source.
#[derive(Clone, Copy, Debug)]
pub struct StreamTerms {
    /// Its promise.
    pub tolerance: Tolerance,
    /// How the scene steps.
    pub integrator: Integrator,
    /// What pulls now, m/s².
    pub gravity: Vec3,
    /// What its publisher may use.
    pub features: Features,
}

/// One reckoned stream at its source.
#[derive(Debug)]
pub struct Publisher {
    stream: StreamId,
    tracks: Tracks,
    features: Features,
    history: History,
    tick: Tick,
    usher: Usher,
    /// By index, how many bodies each holds.
    burdens: Vec<u32>,
    namings: VecDeque<Naming>,
    updates: Vec<Update>,
    /// What a packet expects at its beginning.
    tongue: Tongue,
    statistics: PublisherStatistics,
}

/// What was said of a body could only be read by who had the track of its carrier.
#[derive(Clone, Copy, Debug)]
struct Naming {
    /// The last packet of that tick.
    number: u64,
    body: u32,
    carrier: u32,
}

/// Bodies that others may be held by, at one tick: the largest that move.
const HOLDERS_MAX: usize = 16;
/// A holder is larger than what it holds by this factor at least.
const HOLDER_RATIO: f64 = 1.2;
/// A body is held within this many radii of its holder.
const HOLDER_REACH: f64 = 3.0;

impl Publisher {
    /// A stream without bodies.
    #[must_use]
    pub fn new(stream: StreamId, terms: &StreamTerms, tick: Tick) -> Self {
        Self {
            stream,
            tracks: Tracks::new(terms.tolerance, terms.integrator, terms.gravity),
            features: terms.features,
            history: History::default(),
            tick,
            usher: Usher::default(),
            burdens: Vec::new(),
            namings: VecDeque::new(),
            updates: Vec::new(),
            tongue: Tongue::default(),
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
        self.tracks.place(id, manner, track)
    }

    /// A body has left the scene. What it held is said anew at the next tick.
    pub fn remove(&mut self, id: BodyId) {
        let held_by = self
            .tracks
            .slot(id.index())
            .and_then(|slot| slot.track.carrier);
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
            .map(|(index, slot)| (slot.id(index), slot.track))
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
        self.tick = tick;
        let observations = witness.at(tick).unwrap_or_default();
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        self.usher.sweep(tick);
        // What may hold others is spoken of first, so that what it holds is judged by where it is said to be.
        let holders = if self.features.held {
            self.holders(observations)
        } else {
            Vec::new()
        };
        let holds = |publisher: &Self, place: usize| {
            let index = observations[place].id.index() as usize;
            publisher
                .burdens
                .get(index)
                .is_some_and(|burden| *burden > 0)
        };
        for place in &holders {
            updates.extend(self.judge(witness, tick, &observations[*place], None));
        }

        let burdened: Vec<usize> = (0..observations.len())
            .filter(|place| holds(self, *place) && !holders.contains(place))
            .collect();
        for place in &burdened {
            updates.extend(self.judge(witness, tick, &observations[*place], None));
        }
        for (place, observation) in observations.iter().enumerate() {
            if holders.contains(&place) || burdened.contains(&place) {
                continue;
            }
            let holder = self.holder_of(observation, &holders, observations);
            updates.extend(self.judge(witness, tick, observation, holder));
        }
        self.pack(tick, &mut updates, notices, out);
        self.number_namings();
        self.updates = updates;
    }

    /// What was named in this tick was so in its last packet at the latest; what no repair is asked of any more goes.
    fn number_namings(&mut self) {
        let next = self.history.next();
        for naming in self.namings.iter_mut().rev() {
            if naming.number != u64::MAX {
                break;
            }
            naming.number = next.saturating_sub(1);
        }
        while let Some(oldest) = self.namings.front()
            && oldest.number + (HISTORY_PACKETS as u64) < next
        {
            self.namings.pop_front();
        }
    }

    /// Places among the observations of the largest bodies that move and are not held.
    fn holders(&self, observations: &[Observation]) -> Vec<usize> {
        let mut largest: Vec<(f64, usize)> = Vec::with_capacity(HOLDERS_MAX + 1);
        let mut least = f64::INFINITY;
        for (place, observation) in observations.iter().enumerate() {
            let Some(slot) = self.seen_slot(observation) else {
                continue;
            };
            let radius = slot.radius.metres();
            least = least.min(radius);
            let full = largest.len() == HOLDERS_MAX;
            if slot.track.carrier.is_some() || full && largest[HOLDERS_MAX - 1].0 >= radius {
                continue;
            }
            let at = largest.partition_point(|(other, _)| *other >= radius);
            largest.insert(at, (radius, place));
            largest.truncate(HOLDERS_MAX);
        }
        largest.retain(|(radius, _)| *radius >= least * HOLDER_RATIO);
        largest.into_iter().map(|(_, place)| place).collect()
    }

    /// The slot of a body that was seen at the present tick: not of one that came later, or has the index of one that went.
    fn seen_slot(&self, observation: &Observation) -> Option<&Slot> {
        let slot = self.tracks.slot(observation.id.index())?;
        let there = slot.id(observation.id.index()) == observation.id;
        (there && slot.track.origin <= self.tick).then_some(slot)
    }

    /// The place of the body that could hold another: the one that does, or the nearest within reach.
    fn holder_of(
        &self,
        observation: &Observation,
        holders: &[usize],
        observations: &[Observation],
    ) -> Option<usize> {
        let slot = self.tracks.slot(observation.id.index())?;
        let position = |place: &usize| Vec3::from_array(observations[*place].motion.position());
        let here = Vec3::from_array(observation.motion.position());
        if let Some(carrier) = slot.track.carrier {
            return holders
                .iter()
                .copied()
                .find(|place| observations[*place].id == carrier);
        }
        let radius_of = |place: &usize| {
            let index = observations[*place].id.index();
            self.tracks
                .slot(index)
                .map_or(0.0, |slot| slot.radius.metres())
        };
        holders
            .iter()
            .copied()
            .filter(|place| {
                let radius = radius_of(place);
                let far = f64::from(position(place).distance(here));
                radius >= slot.radius.metres() * HOLDER_RATIO && far <= radius * HOLDER_REACH
            })
            .min_by(|a, b| {
                let far = |place: &usize| position(place).distance_squared(here);
                far(a).total_cmp(&far(b))
            })
    }

    /// Compares one body with its track; when the track no longer holds, replaces it and returns what says so.
    fn judge(
        &mut self,
        witness: &Witness,
        tick: Tick,
        observation: &Observation,
        holder: Option<usize>,
    ) -> Option<Update> {
        let index = observation.id.index();
        let slot = self.seen_slot(observation)?;
        let (saying, track) = match observation.activity {
            Activity::Asleep => {
                let resting = Track::resting(tick, observation.motion);
                let unchanged =
                    slot.track.is_verbatim_rest() && slot.track.anchor == resting.anchor;
                if unchanged {
                    return None;
                }
                (Saying::Whole(TrackSaying::of(&resting)), resting)
            }
            Activity::Awake => self.correct(witness, tick, slot, observation, holder)?,
        };
        let before = slot.track.carrier;
        self.tracks.set_track(index, track);
        if saying.names_carrier()
            && let Some(carrier) = track.carrier.or(before)
        {
            self.namings.push_back(Naming {
                number: u64::MAX,
                body: index,
                carrier: carrier.index(),
            });
        }
        if before != track.carrier {
            self.shift_burden(before, track.carrier);
        }
        let (seat, taken) = self.usher.seat(index, tick);
        if track.is_verbatim_rest() {
            self.usher.leave(index);
        }
        let named = taken || matches!(saying, Saying::Whole(_));
        Some(Update {
            seat,
            body: named.then_some(index),
            saying,
        })
    }

    /// A body was held by the one and is held by the other from now on.
    fn shift_burden(&mut self, from: Option<BodyId>, to: Option<BodyId>) {
        if let Some(from) = from {
            let burden = &mut self.burdens[from.index() as usize];
            *burden = burden.saturating_sub(1);
        }
        if let Some(to) = to {
            let place = to.index() as usize;
            if place >= self.burdens.len() {
                self.burdens.resize(place + 1, 0);
            }
            self.burdens[place] += 1;
        }
    }

    /// What to say of a body that is awake, or `None` while its track holds.
    fn correct(
        &self,
        witness: &Witness,
        tick: Tick,
        slot: &Slot,
        observation: &Observation,
        holder: Option<usize>,
    ) -> Option<(Saying, Track)> {
        let truth = observation.motion.motion();
        let believed = self.tracks.believed(slot, tick);
        let tolerance = self.tracks.tolerance();
        let age = tick.since(slot.track.origin)?;
        let moves = slot.track.predictor != Predictor::Rest;
        let orphaned = slot.track.carrier.is_some() && self.tracks.carrier(&slot.track).is_none();
        let expired = (age >= HORIZON && moves) || orphaned || !self.features.gate;
        let used = share(&truth.pose(), &believed.pose(), tolerance, slot.radius);
        if !expired && used <= 1.0 {
            return None;
        }
        let sight = |id: BodyId| Sight::of(witness, id, tick);
        let seen = sight(observation.id);
        let held_by = holder.and_then(|place| {
            let other = witness.at(tick)?.get(place)?;
            Some((other, sight(other.id)))
        });
        let chooser = Chooser {
            tracks: &self.tracks,
            tongue: &self.tongue,
            features: self.features,
        };
        let subject = Subject {
            index: observation.id.index(),
            slot,
            tick,
            truth,
            past: seen.past,
            ahead: &seen.ahead,
            holder: held_by.as_ref().and_then(|(other, seen)| {
                Some(Holder {
                    index: other.id.index(),
                    slot: self.tracks.slot(other.id.index())?,
                    truth: other.motion.motion(),
                    past: seen.past,
                    ahead: &seen.ahead,
                })
            }),
        };
        let choice = chooser.choose(&subject);
        Some(choice.map_or_else(
            || self.anew(tick, slot, observation, &truth),
            |choice| (choice.saying, choice.track),
        ))
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
        let snapped = Snapped::of(truth, &grid);
        let said = snapped.motion(&grid);
        let used = share(
            &truth.pose(),
            &said.pose(),
            self.tracks.tolerance(),
            slot.radius,
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

    /// Cuts the updates of one tick into datagrams.
    ///
    /// What builds on another body's track comes after that body, in the same packet or a later one.
    fn pack(&mut self, tick: Tick, updates: &mut [Update], notices: u64, out: &mut Vec<Bytes>) {
        updates.sort_unstable_by_key(|update| update.seat);
        if let Some(all) = self.write(tick, updates, notices, true)
            && all.1 == updates.len()
        {
            self.send(all.0, updates, out);
            return;
        }
        updates.sort_by_key(|update| (update.saying.names_carrier(), update.seat));
        let alone = updates.partition_point(|update| !update.saying.names_carrier());
        let (first, second) = updates.split_at(alone);
        for (group, last) in [(first, second.is_empty()), (second, true)] {
            let mut rest: &[Update] = group;
            while let Some((datagram, fitting)) = self.write(tick, rest, notices, last) {
                let (said, later) = rest.split_at(fitting);
                self.send(datagram, said, out);
                rest = later;
            }
        }
    }

    /// A packet of as many updates as fit, and how many those are; it ends its tick if all do and `last` is set.
    fn write(
        &self,
        tick: Tick,
        updates: &[Update],
        notices: u64,
        last: bool,
    ) -> Option<(Vec<u8>, usize)> {
        if updates.is_empty() {
            return None;
        }
        let number = self.history.next();
        let mut writer = StateWriter::new(self.stream, number, tick.value(), notices);
        let fitting = updates
            .iter()
            .take_while(|update| writer.push(update))
            .count();
        Some((writer.finish(last && fitting == updates.len()), fitting))
    }

    fn send(&mut self, datagram: Vec<u8>, said: &[Update], out: &mut Vec<Bytes>) {
        let seats = self.usher.seats();
        let body = |update: &Update| update.body.or_else(|| seats.body(update.seat));
        let mut bodies: Vec<u32> = said.iter().filter_map(body).collect();
        bodies.sort_unstable();
        self.history.record(bodies.into_iter());
        self.statistics.updates += said.len() as u64;
        self.statistics.packets += 1;
        self.statistics.bytes += datagram.len() as u64;
        out.push(Bytes::from(datagram));
    }

    /// The datagram that vouches for the silence since the last packet.
    #[must_use]
    pub fn vouch(&self, notices: u64) -> Bytes {
        let vouch = Vouch {
            next: Low16::of(self.history.next()),
            tick: Low16::of(self.tick.value()),
            notices: Low16::of(notices),
        };
        Bytes::from(vouch.encode(self.stream))
    }

    /// The datagrams that say what the bodies of a lost packet do now, or `None` when it is too old to be known.
    #[must_use]
    pub fn repair(&self, number: u64, notices: u64) -> Option<Vec<Bytes>> {
        let mut writer = RepairWriter::default();
        let mut bodies = self.history.bodies(number)?.to_vec();
        // Who lacks a carrier could not read what named it since.
        let lost = bodies.len();
        for naming in self.namings.iter().filter(|naming| naming.number >= number) {
            if bodies[..lost].binary_search(&naming.carrier).is_ok() {
                bodies.push(naming.body);
            }
        }
        bodies.sort_unstable();
        bodies.dedup();
        // More than a repair holds: a new snapshot is cheaper.
        if bodies.len() > UPDATES_PER_PACKET_MAX {
            return None;
        }
        for index in bodies {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.track.origin).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track);
            writer.push(&RepairRecord {
                index,
                seat: self.usher.seats().of(index),
                age,
                whole,
            });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), notices);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }
}

/// What was seen of a body around a tick.
struct Sight {
    past: [Option<Motion>; 2],
    ahead: Vec<Motion>,
}

impl Sight {
    fn of(witness: &Witness, id: BodyId, tick: Tick) -> Self {
        let motion = |tick: Tick| witness.of(id, tick).map(|seen| seen.motion.motion());
        let past = [1, 2].map(|ticks| tick.before(Ticks::new(ticks)).and_then(motion));
        let ahead = (1..=HINDSIGHT_MAX.count())
            .map_while(|ticks| motion(tick + Ticks::new(ticks)))
            .collect();
        Self { past, ahead }
    }
}
