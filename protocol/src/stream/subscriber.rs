//! Follows a stream: keeps its tracks, and knows which of them to trust.
//!
//! Bytes from anyone: nothing heard may panic, and memory is bounded by the limits. Does not choose when to ask for
//! repair; see the client's session. Invariant: while the stream is settled, every track equals the publisher's.

mod believing;
mod hearing;
mod reading;
mod rebuilding;

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{BodyId, DenseTrack, Metres, Motion, Tick, Tolerance, Track, carried};

use super::before::Before;
use super::bound::Bound;
use super::doubt::Doubts;
use super::gaps::Gaps;
use super::restorer::Restorer;
use super::seats::{Seats, Sitter};
use super::start::StreamStart;
use super::statements::Statements;
use super::statistics::SubscriberStatistics;
use super::tracks::{Manner, Slot, Tracks};
use crate::limits::INDICES_MAX;
use crate::packet::{Doubt, Echo, Head, Low16, StreamId, Update};
use crate::room::{grow_to, push};
use crate::wire::Wire;
use crate::wire::bytes::Reader;

/// One stream at its listener.
#[derive(Clone, Debug)]
pub struct Subscriber {
    stream: StreamId,
    tracks: Tracks,
    /// The snapshot's tick.
    start: Tick,
    every: NonZeroU32,
    /// The number of the first packet.
    first: u64,
    /// The tracks before the present ones, where nothing was said between the two.
    before: Before,
    /// The tracks before these, while packets are missing: each with its body's index.
    older: Vec<(u32, DenseTrack)>,
    /// The newest origin of a track before which too little of its body was heard.
    known_from: Tick,
    gaps: Gaps,
    restorer: Restorer,
    notices: u64,
    /// Datagrams that must wait until more notices were heard.
    held: VecDeque<Vec<u8>>,
    /// Indices of bodies that others hold, and of some that these held once.
    held_indices: Vec<u32>,
    seats: Seats,
    vouched: Tick,
    settled_at: Tick,
    newest: Tick,
    /// The tick of the newest packet that said something.
    spoken: Tick,
    lost_touch: bool,
    doubts: Doubts,
    amended: VecDeque<BodyId>,
    /// Whether the snapshot is whole; until then datagrams wait.
    placed: bool,
    /// Indices that changed since they were last drained, each once, and whether each index is among them.
    changed: Vec<u32>,
    marked: Vec<bool>,
    updates: Vec<Update>,
    /// Of a stream whose source is not trusted with more: indices and seats stay below it, and no body holds another.
    narrow: Option<u32>,
    /// Of a stream with a budget, what it says of how far it exceeds its tolerances.
    statements: Option<Statements>,
    statistics: SubscriberStatistics,
}

impl Subscriber {
    /// A stream of which everything up to `tick` will be placed by the snapshot now arriving.
    ///
    /// `next`: number of the first packet after the snapshot. `notices`: how many the snapshot includes.
    #[must_use]
    pub fn new(start: &StreamStart) -> Self {
        Self {
            stream: start.stream,
            tracks: Tracks::new(
                start.tolerance,
                start.integrator,
                start.every,
                start.gravity,
            ),
            start: start.tick,
            every: start.every,
            first: start.next,
            before: Before::default(),
            older: Vec::new(),
            known_from: Tick::ZERO,
            gaps: Gaps::new(start.next),
            restorer: Restorer::new(start.next),
            notices: start.notices,
            held: VecDeque::new(),
            held_indices: Vec::new(),
            seats: Seats::default(),
            vouched: start.tick,
            settled_at: start.tick,
            newest: start.tick,
            spoken: start.tick,
            lost_touch: false,
            doubts: Doubts::default(),
            amended: VecDeque::new(),
            placed: false,
            changed: Vec::new(),
            marked: Vec::new(),
            updates: Vec::new(),
            narrow: None,
            statements: None,
            statistics: SubscriberStatistics::default(),
        }
    }

    /// The same of a stream whose bodies and seats have numbers below `end` and hold one another never, so that no peer
    /// makes tables longer.
    #[must_use]
    pub(crate) fn narrow(start: &StreamStart, end: u32) -> Self {
        Self {
            narrow: Some(end),
            ..Self::new(start)
        }
    }

    /// The same of a stream with a budget, which may exceed its tolerances and says by how much.
    #[must_use]
    pub fn limited(start: &StreamStart) -> Self {
        Self {
            statements: Some(Statements::new(start.next, start.tick)),
            ..Self::new(start)
        }
    }

    /// The factor by which tolerances may be exceeded at a tick: one, unless the stream has a budget that did not suffice;
    /// `None` where a stream with a budget was not heard to say it.
    #[must_use]
    pub fn excess_at(&self, tick: Tick) -> Option<f64> {
        self.statements
            .as_ref()
            .map_or(Some(1.0), |said| said.at(tick))
    }

    /// How many packets are missing.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.gaps.missing().count()
    }

    /// The numbers of the packets that are missing, in rising order.
    pub fn missing_packets(&self) -> impl Iterator<Item = u64> + Clone {
        self.gaps.missing()
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

    /// Its promise for a body: by the body's class.
    #[must_use]
    pub fn tolerance_of(&self, id: BodyId) -> Option<Tolerance> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| self.tracks.tolerance_of(slot))
    }

    /// What it heard so far.
    #[must_use]
    pub const fn statistics(&self) -> SubscriberStatistics {
        self.statistics
    }

    /// The newest tick up to which everything that was sent is known to have been sent.
    #[must_use]
    pub const fn vouched(&self) -> Tick {
        self.vouched
    }

    /// For how many ticks up to the vouched one nothing was said. A stream that runs freely vouches again before it has
    /// been silent for twice as long, or for two and a half seconds more (PROTOCOL 6.4).
    #[must_use]
    pub const fn silent_ticks(&self) -> u64 {
        self.vouched.value().saturating_sub(self.spoken.value())
    }

    /// The newest tick at which the promise holds for every body.
    #[must_use]
    pub fn complete(&self) -> Tick {
        if self.is_settled() && self.known_from <= self.vouched {
            self.vouched
        } else {
            self.settled_at
        }
    }

    /// The tick from which on everything is known, up to the vouched one, while nothing is missing.
    pub(crate) const fn known_from(&self) -> Tick {
        self.known_from
    }

    /// Whether nothing is missing.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.placed && self.gaps.is_settled() && self.held.is_empty() && !self.lost_touch
    }

    /// Whether so much is missing that only a new snapshot helps.
    #[must_use]
    pub const fn has_lost_touch(&self) -> bool {
        self.lost_touch
    }

    /// One more than the highest index that any body had.
    #[must_use]
    pub fn index_end(&self) -> usize {
        self.tracks.len()
    }

    /// The body that has an index now.
    #[must_use]
    pub fn body(&self, index: u32) -> Option<BodyId> {
        self.tracks.slot(index).map(|slot| slot.id(index))
    }

    /// The label that a body was placed with.
    pub(crate) fn label(&self, id: BodyId) -> Option<u32> {
        let slot = self.tracks.slot(id.index())?;
        self.tracks
            .label(slot)
            .filter(|_| slot.id(id.index()) == id)
    }

    /// A body's track.
    #[must_use]
    pub fn track(&self, id: BodyId) -> Option<Track> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| slot.track())
    }

    /// Whether a body was said to lie still in the world: see [`Track::is_resting`].
    #[must_use]
    pub fn is_resting(&self, id: BodyId) -> Option<bool> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| slot.dense().is_resting())
    }

    /// What is believed of a body at a tick: by its track, or before that one's origin by the track before.
    #[must_use]
    pub fn believed(&self, id: BodyId, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        if slot.id(id.index()) != id {
            return None;
        }
        let present = slot.track();
        let track = self.track_at(id.index(), &present, tick);
        let track = track.unwrap_or(present);
        let motion = self.tracks.framed((id.index(), slot), &track, tick);
        let Some((index, carrier)) = self.tracks.carrier(&track) else {
            return Some(motion);
        };
        let present = carrier.track();
        let held_by = self.track_at(index, &present, tick).unwrap_or(present);
        let by = self.tracks.framed((index, carrier), &held_by, tick);
        Some(carried(&by, &motion.pose()))
    }

    /// What a track of a body, this one or one that it had, says of a tick.
    pub(crate) fn predicted(&self, id: BodyId, track: &Track, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| self.tracks.framed_fresh(slot, track, tick))
    }

    /// Which of a body's last two tracks held at a tick, as far as is known.
    fn track_at(&self, index: u32, track: &Track, tick: Tick) -> Option<Track> {
        if track.origin <= tick {
            return Some(*track);
        }
        let before = self.before.get(index);
        before.filter(|before| before.origin <= tick)
    }

    /// How far off the copy of a body may be at the vouched tick.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<Bound> {
        self.bound_at(id, self.vouched)
    }

    /// How far off the copy of a body may be at a tick; unknown for one that is not vouched for yet, that lies before the
    /// tracks that are still held, or between two ticks that are spoken of.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<Bound> {
        let track = self.track(id)?;
        let slot = self.tracks.slot(id.index())?;
        let since = self.settled_at;
        let doubted = self.gaps.doubted_before();
        let in_doubt = |track: &Track| doubted.is_some_and(|before| track.origin < before);
        let sure = |index: u32, track: &Track| {
            let held = self.track_at(index, track, tick);
            held.filter(|held| !in_doubt(held))
        };
        let known = sure(id.index(), &track).is_some_and(|then| match then.carrier {
            None => true,
            // What is held is known as well as its holder.
            Some(_) => self
                .tracks
                .carrier(&then)
                .is_some_and(|(index, carrier)| sure(index, &carrier.track()).is_some()),
        });
        if tick > self.vouched || !self.is_spoken_of(tick) || self.lost_touch || !known {
            return Some(Bound::Unknown { since });
        }
        let Some(excess) = self.excess_at(tick) else {
            return Some(Bound::Unknown { since });
        };
        let reach = self
            .tracks
            .tolerance_of(slot)
            .reach(self.tracks.radius(slot));
        Some(Bound::Within(Metres::new(reach.metres() * excess)))
    }

    /// Whether the promise is about a tick.
    fn is_spoken_of(&self, tick: Tick) -> bool {
        tick == self.start || tick.value().is_multiple_of(u64::from(self.every.get()))
    }

    /// The last tick before this one that the promise is about.
    fn spoken_before(&self, tick: Tick) -> Tick {
        let before = tick.value().saturating_sub(1);
        Tick::new(before - before % u64::from(self.every.get()))
    }

    /// Moves the indices of bodies that came, went or were updated since the last call into `out`, in no order,
    /// each once.
    pub fn drain_changed(&mut self, out: &mut Vec<u32>) {
        for index in &self.changed {
            self.marked[*index as usize] = false;
        }
        if out.is_empty() {
            // What was asked for last has the room that the next changes need.
            core::mem::swap(out, &mut self.changed);
        } else {
            out.append(&mut self.changed);
        }
    }

    /// Counts an index as changed.
    fn touch(&mut self, index: u32) {
        let place = index as usize;
        grow_to(&mut self.marked, place + 1, || false);
        if !core::mem::replace(&mut self.marked[place], true) {
            push(&mut self.changed, index);
        }
    }

    /// Counts what is held as changed where its holder is.
    fn touch_held(&mut self) {
        let mut held = core::mem::take(&mut self.held_indices);
        held.retain(|index| {
            let Some(carrier) = self.tracks.slot(*index).and_then(Slot::carrier) else {
                return false;
            };
            let moved = self.marked.get(carrier.index() as usize);
            if moved.copied().unwrap_or_default() {
                self.touch(*index);
            }
            true
        });
        self.held_indices = held;
    }

    /// Counts every index below this one as changed.
    pub(crate) fn touch_below(&mut self, end: usize) {
        for index in 0..end as u32 {
            self.touch(index);
        }
    }

    /// A notice placed a body; `false` when that breaks a limit.
    #[must_use]
    pub fn place(&mut self, id: BodyId, manner: &Manner, track: Track) -> bool {
        self.place_labelled(id, manner, track, self.label(id))
    }

    /// The same with a label, a number of the caller's own that many bodies may share; the other keeps it.
    #[must_use]
    pub(crate) fn place_labelled(
        &mut self,
        id: BodyId,
        manner: &Manner,
        track: Track,
        label: Option<u32>,
    ) -> bool {
        let placed = self.tracks.place(id, manner, track, label);
        if placed {
            self.seats.dismiss(id.index());
            if track.carrier.is_some() {
                self.held_indices.push(id.index());
            }
            self.touch(id.index());
            self.before.forget(id.index());
        }
        placed
    }

    /// A body has a seat already, as a late listener is told.
    pub fn seat(&mut self, id: BodyId, seat: u32) {
        if id.index() < INDICES_MAX && seat < INDICES_MAX {
            self.seats
                .take(seat, id.index(), self.newest, Sitter::AsSaid);
        }
    }

    /// A notice took a body out; `false` when it is not there.
    #[must_use]
    pub fn remove(&mut self, id: BodyId) -> bool {
        self.touch(id.index());
        let removed = self.tracks.remove(id);
        if removed {
            self.seats.dismiss(id.index());
        }
        removed
    }

    /// A notice changed the gravity.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
    }

    /// A notice was heard and taken in; datagrams that waited for it are read now.
    pub fn handle_notice(&mut self) {
        self.notices += 1;
        self.read_held();
    }

    /// The snapshot is whole; datagrams that waited for it are read now.
    pub fn handle_snapshot_end(&mut self) {
        self.placed = true;
        self.read_held();
    }

    fn read_held(&mut self) {
        for _ in 0..self.held.len() {
            if let Some(datagram) = self.held.pop_front() {
                self.read(&datagram);
            }
        }
        self.note_settled();
    }

    /// Whether a datagram names this stream.
    #[must_use]
    pub fn is_about(&self, datagram: &[u8]) -> bool {
        Head::decode(&mut Reader::new(datagram)).is_ok_and(|head| head.stream == self.stream)
    }

    /// Takes in a datagram of this stream. One that is malformed or of another stream changes nothing but a count.
    pub fn handle_datagram(&mut self, datagram: &[u8]) {
        self.read(datagram);
        self.note_settled();
    }

    fn note_settled(&mut self) {
        self.settled_at = self.complete();
        if self.gaps.is_settled() {
            self.older.clear();
            self.seats.forget();
        }
    }

    /// Nobody asks any more what was believed at a tick before this one: tracks that bodies left by then, as far as
    /// everything was heard, are kept no longer. A [`bound`](Self::bound_at) at such a tick may be unknown from now on.
    pub fn forget_before(&mut self, tick: Tick) {
        let end = tick.min(self.settled_at);
        let tracks = &self.tracks;
        self.before
            .retain(|index| tracks.slot(index).is_some_and(|slot| slot.origin() > end));
    }

    /// What the publisher is to be asked, because a sum over tracks is another here.
    #[must_use]
    pub fn doubt(&self) -> Option<Doubt> {
        self.doubts.doubt()
    }

    /// The sum over all tracks, by which two ends can be compared.
    #[must_use]
    pub fn agreement(&self) -> u64 {
        self.tracks.agreement().value()
    }

    /// The next body whose track was made right.
    pub fn poll_amended(&mut self) -> Option<BodyId> {
        self.amended.pop_front()
    }

    /// How many of the packets that are known to have been sent did not come by themselves, since this began.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        let heard = self.statistics.packets - self.statistics.rebuilt;
        (self.gaps.next() - self.first).saturating_sub(heard)
    }

    /// What to tell the server: how far this has heard, and the oldest packets that are missing.
    #[must_use]
    pub fn echo(&self) -> Echo {
        self.echo_of(self.gaps.missing())
    }

    /// The same, naming only these of the missing packets, in rising order.
    #[must_use]
    pub fn echo_for(&self, asked: &[u64]) -> Echo {
        let missing = self.gaps.missing();
        self.echo_of(missing.filter(|number| asked.binary_search(number).is_ok()))
    }

    fn echo_of(&self, missing: impl Iterator<Item = u64> + Clone) -> Echo {
        let parities = self.restorer.wanted(missing.clone(), self.gaps.next());
        // What was heard is read as soon as what it waits for is there.
        let waits = |number: &u64| parities > 0 && self.restorer.column(*number).is_some();
        let lost = missing.filter(|number| !waits(number));
        Echo {
            next: Low16::of(self.gaps.next()),
            gone: Low16::of(self.lost()),
            parities,
            lost: lost
                .take(crate::limits::LOST_NAMED_MAX)
                .map(Low16::of)
                .collect(),
        }
    }
}
