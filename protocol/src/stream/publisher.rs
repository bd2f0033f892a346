//! Compares truth with what was said; says what would break the tolerance.
//!
//! Knows nothing of who listens: what it says is encoded once for all. Invariant: after `publish`, every observed body
//! is within the tolerance of its track, grid error included.

use alloc::vec::Vec;

use bytes::Bytes;
use glam::{DVec3, Vec3};
use rhumb_reckoning::{
    Anchor, BodyId, Divergence, HORIZON, Integrator, Metres, Motion, Predictor, Residual, Snapped,
    Tick, Ticks, Tolerance, Track,
};

use super::choose::{Record, law};
use super::history::History;
use super::observation::{Activity, Observation};
use super::tracks::{Manner, Slot, Tracks};
use crate::packet::{
    Low16, RepairRecord, RepairWriter, Saying, StateWriter, StreamId, TrackSaying, Update, Vouch,
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

/// One reckoned stream at its source.
#[derive(Debug)]
pub struct Publisher {
    stream: StreamId,
    tracks: Tracks,
    /// Linear velocity of each body when it was last observed, and when that was.
    last_seen: Vec<(Tick, Vec3)>,
    history: History,
    tick: Tick,
    updates: Vec<Update>,
    statistics: PublisherStatistics,
}

impl Publisher {
    /// A stream without bodies, under the gravity that pulls now.
    #[must_use]
    pub fn new(
        stream: StreamId,
        tolerance: Tolerance,
        integrator: Integrator,
        gravity: Vec3,
        tick: Tick,
    ) -> Self {
        Self {
            stream,
            tracks: Tracks::new(tolerance, integrator, gravity),
            last_seen: Vec::new(),
            history: History::default(),
            tick,
            updates: Vec::new(),
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
        let index = id.index() as usize;
        if !self.tracks.place(id, manner, track) {
            return false;
        }
        if index >= self.last_seen.len() {
            self.last_seen.resize(index + 1, (Tick::ZERO, Vec3::NAN));
        }
        // A velocity that nothing is near to: the first tick of a body says nothing of its acceleration.
        self.last_seen[index] = (track.origin, Vec3::NAN);
        true
    }

    /// A body has left the scene.
    pub fn remove(&mut self, id: BodyId) {
        self.tracks.remove(id);
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

    /// Says what must be said at a tick and appends the datagrams to `out`; none when every track still holds.
    ///
    /// `observations` come in order of id. `notices`: how many the scene has given, up to this tick.
    pub fn publish(
        &mut self,
        tick: Tick,
        observations: &[Observation],
        notices: u64,
        out: &mut Vec<Bytes>,
    ) {
        self.tick = tick;
        let mut updates = core::mem::take(&mut self.updates);
        updates.clear();
        for observation in observations {
            updates.extend(self.judge(tick, observation));
        }
        self.pack(tick, &updates, notices, out);
        self.updates = updates;
    }

    /// Compares one body with its track; when the track no longer holds, replaces it and returns what says so.
    fn judge(&mut self, tick: Tick, observation: &Observation) -> Option<Update> {
        let index = observation.id.index();
        let slot = self.tracks.slot(index)?;
        let [.., vx, vy, vz, _, _, _] = observation.motion.parts();
        let velocity = Vec3::new(vx, vy, vz);
        let (last_tick, last_velocity) =
            core::mem::replace(&mut self.last_seen[index as usize], (tick, velocity));
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
            Activity::Awake => {
                let consecutive = last_tick.next() == tick && last_velocity.is_finite();
                let before = consecutive.then(|| last_velocity.as_dvec3());
                self.correct(tick, slot, observation, before)?
            }
        };
        self.tracks.slot_mut(index)?.track = track;
        Some(Update { index, saying })
    }

    /// What to say of a body that is awake, or `None` while its track holds.
    fn correct(
        &self,
        tick: Tick,
        slot: &Slot,
        observation: &Observation,
        velocity_before: Option<DVec3>,
    ) -> Option<(Saying, Track)> {
        let truth = observation.motion.motion();
        let believed = self.tracks.believed(slot, tick);
        let tolerance = self.tracks.tolerance().metres();
        let age = tick.since(slot.track.origin)?;
        let expired = age >= HORIZON && !slot.track.is_resting();
        if !expired && error(&truth, &believed, slot.radius) <= tolerance.metres() {
            return None;
        }
        let record = Record {
            truth: &truth,
            velocity_before,
            gravity: self.tracks.gravity(slot, tick),
            radius: slot.radius,
        };
        let step = self.tracks.integrator().rate.step();
        let predictor = law(&record, step, tolerance);
        let candidates = [
            self.residual(predictor, age, slot, &truth, &believed),
            Some(self.whole(predictor, slot, &truth)),
        ];
        let grid = self.tracks.grid(slot);
        let fits = |saying: &Saying| {
            let track = Tracks::said(saying, tick, &believed, &grid);
            error(&truth, &track.start(&grid), slot.radius) <= tolerance.metres()
        };
        let shortest = candidates
            .into_iter()
            .flatten()
            .filter(fits)
            .min_by_key(Saying::bit_len);
        // Where the grid is too coarse for the promise (a body of a hundred metres, say), the engine's own bits are not.
        let saying = shortest.unwrap_or_else(|| {
            let resting = predictor == Predictor::Rest;
            let motion = observation.motion;
            let anchor = Anchor::Verbatim(if resting { motion.stilled() } else { motion });
            Saying::Whole(TrackSaying { predictor, anchor })
        });
        let track = Tracks::said(&saying, tick, &believed, &grid);
        Some((saying, track))
    }

    fn residual(
        &self,
        predictor: Predictor,
        age: Ticks,
        slot: &Slot,
        truth: &Motion,
        believed: &Motion,
    ) -> Option<Saying> {
        let readable = age > Ticks::ZERO && age <= HORIZON;
        let mut residual = Residual::between(truth, believed, &self.tracks.grid(slot))?;
        if predictor == Predictor::Rest {
            (residual.linear, residual.angular) = ([0; 3], [0; 3]);
        }
        readable.then_some(Saying::Residual {
            predictor,
            age,
            residual,
        })
    }

    fn whole(&self, predictor: Predictor, slot: &Slot, truth: &Motion) -> Saying {
        let snapped = Snapped::of(truth, &self.tracks.grid(slot));
        let resting = predictor == Predictor::Rest;
        let anchor = Anchor::Snapped(if resting { snapped.stilled() } else { snapped });
        Saying::Whole(TrackSaying { predictor, anchor })
    }

    /// Cuts the updates of one tick into datagrams.
    fn pack(&mut self, tick: Tick, updates: &[Update], notices: u64, out: &mut Vec<Bytes>) {
        let mut rest = updates;
        while !rest.is_empty() {
            let number = self.history.next();
            let mut writer = StateWriter::new(self.stream, number, tick.value(), notices);
            let fitting = rest.iter().take_while(|update| writer.push(update)).count();
            let (said, later) = rest.split_at(fitting);
            let datagram = writer.finish(later.is_empty());
            self.history.record(said.iter().map(|update| update.index));
            self.statistics.updates += said.len() as u64;
            self.statistics.packets += 1;
            self.statistics.bytes += datagram.len() as u64;
            out.push(Bytes::from(datagram));
            rest = later;
        }
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
        for &index in self.history.bodies(number)? {
            let Some(slot) = self.tracks.slot(index) else {
                continue;
            };
            let age = self.tick.since(slot.track.origin).unwrap_or_default();
            let whole = TrackSaying::of(&slot.track);
            writer.push(&RepairRecord { index, age, whole });
        }
        let datagrams = writer.finish(self.stream, number, self.tick.value(), notices);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }
}

/// How far any point of a body is from where it is believed, metres.
fn error(truth: &Motion, believed: &Motion, radius: Metres) -> f64 {
    Divergence::between(&truth.pose(), &believed.pose())
        .surface_error(radius)
        .metres()
}
