//! Follows a stream: keeps its tracks, and knows which of them to trust.
//!
//! Bytes from anyone: nothing heard may panic, and memory is bounded by the limits. Does not choose when to ask for
//! repair; see the client's session. Invariant: while the stream is settled, every track equals the publisher's.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Integrator, Metres, Motion, Predictor, Tick, Tolerance, Track};

use super::gaps::{Arrival, Gaps, RepairOf};
use super::tracks::{Manner, Tracks, Unreadable};
use crate::limits::{PACKETS_HELD_MAX, TICK_JUMP_MAX};
use crate::packet::{
    Echo, FullPacket, Head, Kind, Low16, Repair, Saying, StatePacket, StreamId, TrackSaying,
    Update, Vouch,
};
use crate::wire::bytes::Reader;
use crate::wire::{Malformed, Wire};

/// How far the copy of one body may be from the truth, at the newest tick that the stream has vouched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// Every point of it is within this distance of where it is.
    ///
    /// A body that was said to rest to the bit is no exception: it may have woken since, and not moved enough to be
    /// spoken of.
    Within(Metres),
    /// A packet that may have spoken of it was lost and is not made good yet; the tolerance held at this tick.
    Unknown {
        /// Up to which the stream was whole.
        since: Tick,
    },
}

/// What a subscriber heard so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriberStatistics {
    /// Datagrams of this stream that were read.
    pub packets: u64,
    /// Updates taken in.
    pub updates: u64,
    /// Datagrams that came twice.
    pub duplicates: u64,
    /// Datagrams that are not of the protocol.
    pub malformed: u64,
    /// Packets found missing.
    pub missed: u64,
    /// Repairs taken in, in parts.
    pub repairs: u64,
    /// Updates that built on a missing one.
    pub unread: u64,
    /// Packets dropped because too many waited for notices.
    pub overflowed: u64,
}

/// One stream at its listener.
#[derive(Debug)]
pub struct Subscriber {
    stream: StreamId,
    tracks: Tracks,
    /// By index, the track before the present one, where nothing was said between the two.
    before: Vec<Option<Track>>,
    /// The newest origin of a track before which too little of its body was heard.
    known_from: Tick,
    gaps: Gaps,
    notices: u64,
    /// Datagrams that must wait until more notices were heard.
    held: VecDeque<Vec<u8>>,
    vouched: Tick,
    settled_at: Tick,
    newest: Tick,
    lost_touch: bool,
    /// Whether the snapshot is whole; until then datagrams wait.
    placed: bool,
    /// Indices that changed since they were last drained, each once, and whether each index is among them.
    changed: Vec<u32>,
    marked: Vec<bool>,
    updates: Vec<Update>,
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
            tracks: Tracks::new(start.tolerance, start.integrator, start.gravity),
            before: Vec::new(),
            known_from: Tick::ZERO,
            gaps: Gaps::new(start.next),
            notices: start.notices,
            held: VecDeque::new(),
            vouched: start.tick,
            settled_at: start.tick,
            newest: start.tick,
            lost_touch: false,
            placed: false,
            changed: Vec::new(),
            marked: Vec::new(),
            updates: Vec::new(),
            statistics: SubscriberStatistics::default(),
        }
    }

    /// How many packets are missing.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.gaps.missing().count()
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

    /// The newest tick at which the promise holds for every body.
    #[must_use]
    pub fn complete(&self) -> Tick {
        if self.is_settled() && self.known_from <= self.vouched {
            self.vouched
        } else {
            self.settled_at
        }
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

    /// A body's track.
    #[must_use]
    pub fn track(&self, id: BodyId) -> Option<&Track> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then_some(&slot.track)
    }

    /// What is believed of a body at a tick: by its track, or before that one's origin by the track before.
    #[must_use]
    pub fn believed(&self, id: BodyId, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        if slot.id(id.index()) != id {
            return None;
        }
        let track = self.track_at(id.index(), &slot.track, tick);
        Some(
            self.tracks
                .predicted(slot, track.unwrap_or(&slot.track), tick),
        )
    }

    /// Which of a body's last two tracks held at a tick, as far as is known.
    fn track_at<'a>(&'a self, index: u32, track: &'a Track, tick: Tick) -> Option<&'a Track> {
        if track.origin <= tick {
            return Some(track);
        }
        let before = self.before.get(index as usize)?.as_ref();
        before.filter(|before| before.origin <= tick)
    }

    /// How far off the copy of a body may be at the vouched tick.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<Bound> {
        self.bound_at(id, self.vouched)
    }

    /// How far off the copy of a body may be at a tick; unknown for one that is not vouched for yet, or that lies before
    /// the tracks that are still held.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<Bound> {
        let track = self.track(id)?;
        let since = self.settled_at;
        let doubted = self.gaps.doubted_before();
        let in_doubt = |track: &Track| doubted.is_some_and(|before| track.origin < before);
        let held = self.track_at(id.index(), track, tick);
        if tick > self.vouched || self.lost_touch || held.is_none_or(in_doubt) {
            return Some(Bound::Unknown { since });
        }
        Some(Bound::Within(self.tolerance().metres()))
    }

    /// Moves the indices of bodies that came, went or were updated since the last call into `out`, in no order,
    /// each once.
    pub fn drain_changed(&mut self, out: &mut Vec<u32>) {
        for index in &self.changed {
            self.marked[*index as usize] = false;
        }
        out.append(&mut self.changed);
    }

    /// Counts an index as changed.
    fn touch(&mut self, index: u32) {
        let place = index as usize;
        if place >= self.marked.len() {
            self.marked.resize(place + 1, false);
        }
        if !core::mem::replace(&mut self.marked[place], true) {
            self.changed.push(index);
        }
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
        let placed = self.tracks.place(id, manner, track);
        if placed {
            self.touch(id.index());
            self.remember(id.index(), None);
        }
        placed
    }

    /// A notice took a body out; `false` when it is not there.
    #[must_use]
    pub fn remove(&mut self, id: BodyId) -> bool {
        self.touch(id.index());
        self.tracks.remove(id)
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

    /// Takes in a datagram of this stream. One that is malformed or of another stream changes nothing but a count.
    pub fn handle_datagram(&mut self, datagram: &[u8]) {
        self.read(datagram);
        self.note_settled();
    }

    fn note_settled(&mut self) {
        self.settled_at = self.complete();
    }

    fn remember(&mut self, index: u32, before: Option<Track>) {
        let index = index as usize;
        if index >= self.before.len() {
            self.before.resize(index + 1, None);
        }
        self.before[index] = before;
    }

    /// Takes in what was overtaken by a newer saying: it is what held until then.
    fn take_overtaken(&mut self, index: u32, tick: Tick, saying: &Saying) {
        let Some(Some(before)) = self.before.get(index as usize) else {
            return;
        };
        let present = self.tracks.slot(index).map(|slot| slot.track.origin);
        if before.origin >= tick || present.is_none_or(|origin| origin <= tick) {
            return;
        }
        match saying {
            Saying::Whole(whole) => self.remember(index, Some(whole.track(tick))),
            Saying::Residual { .. } => self.forget_before(index),
        }
    }

    /// Of what a body did before its present track, too little was heard.
    fn forget_before(&mut self, index: u32) {
        if let Some(origin) = self.tracks.slot(index).map(|slot| slot.track.origin) {
            self.remember(index, None);
            self.known_from = self.known_from.max(origin);
        }
    }

    /// Takes in what a packet says of a body.
    fn take(&mut self, index: u32, tick: Tick, saying: &Saying) -> Result<(), Unreadable> {
        let before = self.tracks.slot(index).map(|slot| slot.track);
        let heard = self.tracks.hear(index, tick, saying);
        if heard == Err(Unreadable::Superseded) {
            self.take_overtaken(index, tick, saying);
        }
        heard?;
        self.remember(index, before);
        self.statistics.updates += 1;
        self.touch(index);
        Ok(())
    }

    fn read(&mut self, datagram: &[u8]) {
        if self.try_read(datagram).is_err() {
            self.statistics.malformed += 1;
        }
    }

    fn try_read(&mut self, datagram: &[u8]) -> Result<(), Malformed> {
        let mut reader = Reader::new(datagram);
        let head = Head::decode(&mut reader)?;
        if head.stream != self.stream {
            return Err(Malformed::UnknownCode);
        }
        match head.kind {
            Kind::State => self.read_state(datagram, StatePacket::decode(false, reader)?),
            Kind::StateEnd => self.read_state(datagram, StatePacket::decode(true, reader)?),
            Kind::Full => self.read_full(datagram, &FullPacket::decode(false, reader)?),
            Kind::FullEnd => self.read_full(datagram, &FullPacket::decode(true, reader)?),
            Kind::Vouch => self.read_vouch(datagram, Vouch::decode(reader)?),
            Kind::Repair => self.read_repair(datagram, &Repair::decode(reader)?),
            Kind::Echo => return Err(Malformed::UnknownCode),
        }?;
        Ok(())
    }

    /// Whether the notices that a datagram builds on were heard; if not, keeps it for later.
    fn is_due(&mut self, notices: Low16, datagram: &[u8]) -> bool {
        if self.placed && notices.expand(self.notices) <= self.notices {
            return true;
        }
        if self.held.len() < PACKETS_HELD_MAX {
            self.held.push_back(datagram.to_vec());
        } else {
            self.statistics.overflowed += 1;
        }
        false
    }

    fn tick_of(&self, tick: Low16) -> Tick {
        Tick::new(tick.expand(self.newest.value()))
    }

    /// Whether a tick lies so far ahead that the stream is begun anew rather than gone on with.
    fn jumps(&self, tick: Tick) -> bool {
        tick.value() > self.newest.value() + TICK_JUMP_MAX
    }

    /// Counts a numbered packet; returns its number and tick when it is to be read.
    fn arrive(&mut self, number: Low16, tick: Low16, ends_tick: bool) -> Option<(u64, Tick)> {
        let number = number.expand(self.gaps.next());
        let tick = self.tick_of(tick);
        let next = self.gaps.next();
        if self.jumps(tick) {
            self.lost_touch = true;
            return None;
        }
        match self.gaps.arrive(number, tick) {
            Arrival::Fresh => {}
            Arrival::Duplicate => {
                self.statistics.duplicates += 1;
                return None;
            }
            Arrival::Lost => {
                self.lost_touch = true;
                return None;
            }
        }
        self.statistics.packets += 1;
        self.statistics.missed += number.saturating_sub(next);
        self.newest = self.newest.max(tick);
        let whole = if ends_tick {
            Some(tick)
        } else {
            tick.before(rhumb_reckoning::Ticks::new(1))
        };
        self.vouched = self.vouched.max(whole.unwrap_or_default());
        Some((number, tick))
    }

    fn read_state(&mut self, datagram: &[u8], packet: StatePacket<'_>) -> Result<(), Malformed> {
        if !self.is_due(packet.notices, datagram) {
            return Ok(());
        }
        // Everything is decoded before anything is believed.
        let mut updates = core::mem::take(&mut self.updates);
        let (number, tick, ends_tick) = (packet.number, packet.tick, packet.ends_tick);
        let decoded = packet.updates(&mut updates);
        if decoded.is_ok()
            && let Some((number, tick)) = self.arrive(number, tick, ends_tick)
        {
            for update in &updates {
                self.hear(number, tick, update);
            }
        }
        self.updates = updates;
        decoded
    }

    fn hear(&mut self, number: u64, tick: Tick, update: &Update) {
        match self.take(update.index, tick, &update.saying) {
            Ok(()) => {}
            Err(Unreadable::OtherRevision) => {
                self.statistics.unread += 1;
                self.gaps.could_not_read(number, tick);
            }
            // Removed or said anew since: what came later stands.
            Err(Unreadable::NoBody | Unreadable::Superseded) => {}
        }
    }

    fn read_full(&mut self, datagram: &[u8], packet: &FullPacket) -> Result<(), Malformed> {
        if !self.is_due(packet.notices, datagram) {
            return Ok(());
        }
        let Some((_, tick)) = self.arrive(packet.number, packet.tick, packet.ends_tick) else {
            return Ok(());
        };
        for record in &packet.records {
            let saying = Saying::Whole(TrackSaying {
                predictor: Predictor::Uniform,
                anchor: rhumb_reckoning::Anchor::Verbatim(record.motion),
            });
            // Removed or said anew since: what came later stands.
            let _ = self.take(record.index, tick, &saying);
        }
        Ok(())
    }

    fn read_vouch(&mut self, datagram: &[u8], vouch: Vouch) -> Result<(), Malformed> {
        if !self.is_due(vouch.notices, datagram) {
            return Ok(());
        }
        let tick = self.tick_of(vouch.tick);
        let before = self.gaps.next();
        let next = vouch.next.expand(before);
        if self.jumps(tick) || !self.gaps.announce(next, tick) {
            self.lost_touch = true;
            return Ok(());
        }
        self.statistics.missed += next.saturating_sub(before);
        self.newest = self.newest.max(tick);
        self.vouched = self.vouched.max(tick);
        Ok(())
    }

    fn read_repair(&mut self, datagram: &[u8], repair: &Repair) -> Result<(), Malformed> {
        if !self.is_due(repair.notices, datagram) {
            return Ok(());
        }
        let as_of = self.tick_of(repair.tick);
        if self.jumps(as_of) {
            self.lost_touch = true;
            return Ok(());
        }
        self.statistics.repairs += 1;
        for record in &repair.records {
            let Some(origin) = as_of.before(record.age) else {
                return Err(Malformed::OutOfRange);
            };
            let whole = Saying::Whole(record.whole);
            if self.tracks.hear(record.index, origin, &whole).is_ok() {
                self.touch(record.index);
            }
            self.forget_before(record.index);
        }
        let lost = repair.lost.expand(self.gaps.next());
        let of = RepairOf {
            as_of,
            notices: repair.notices.expand(self.notices),
            parts: repair.parts,
        };
        self.gaps.repaired(lost, of, repair.part);
        Ok(())
    }

    /// What to tell the server: how far this has heard, and the oldest packets that are missing.
    #[must_use]
    pub fn echo(&self) -> Echo {
        Echo {
            next: Low16::of(self.gaps.next()),
            lost: self
                .gaps
                .missing()
                .take(crate::limits::LOST_NAMED_MAX)
                .map(Low16::of)
                .collect(),
        }
    }
}

/// Where a subscriber begins: what the server says when a member joins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamStart {
    /// The stream's name.
    pub stream: StreamId,
    /// Its promise.
    pub tolerance: Tolerance,
    /// How the scene steps.
    pub integrator: Integrator,
    /// What pulls now.
    pub gravity: Vec3,
    /// The tick of the snapshot.
    pub tick: Tick,
    /// Number of the first packet after it.
    pub next: u64,
    /// Notices that it includes.
    pub notices: u64,
}
