//! The subscriber of a stream: keeps its tracks and knows which are certain.
//!
//! Bytes come from untrusted peers: none may panic, and memory is bounded by the limits. Does not choose when to
//! report losses; see `receiver`. Invariant: while the stream is converged, every track equals the publisher's.

mod in_force;
mod lifetimes;
mod reading;

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::fmt;
use core::num::NonZeroU32;

use glam::Vec3;
use lifetimes::{Lifetimes, SilentPublishers};
use rhumb_reckoning::{BodyId, Metres, Motion, Tick, Ticks, Tolerance, Track};

use self::lifetimes::EarlierTracks;
use super::StreamStart;
use super::aliases::{AliasOwner, ReceivedAliases};
use super::fec::FecDecoder;
use super::gaps::{ErrorScaleLog, PacketGaps};
use super::losses::RelayedPackets;
use super::tracks::{PredictionParameters, Slot, Tracks};
use crate::interner::{grow_to, push};
use crate::limits::INDICES_MAX;
use crate::packet::{Datagram, Head, LargestPacket, LossReport, Low16, StreamId, Update};
use crate::scene::Stepping;

pub use in_force::{FreeTrack, FreeTracksX4, Replacement, ShownTrack};

/// The past that a view still shows.
#[derive(Clone, Copy, Debug)]
struct ShownPast {
    /// The earliest tick.
    from: Tick,
    /// Ticks from that to the newest one, at the last view.
    behind: u64,
}

/// Ticks by which a view may fall further behind from one frame to the next.
const HISTORY_SLACK: u64 = 4;

/// The subscriber of one stream.
#[derive(Clone, Debug)]
pub struct Subscriber {
    stream: StreamId,
    largest_packet: LargestPacket,
    tracks: Tracks,
    /// The tick of the snapshot.
    start: Tick,
    publish_interval: NonZeroU32,
    /// The number of the first packet.
    first: u64,
    /// The tracks before the present ones.
    earlier_tracks: EarlierTracks,
    lifetimes: Lifetimes,
    silent_publishers: SilentPublishers,
    /// The past that a view shows; `None` before the first [`Self::forget_before`].
    shown: Option<ShownPast>,
    /// Ticks before the newest one that a view shows because of its delay.
    history: u64,
    lookahead: Ticks,
    stepping: Stepping,
    /// Before this tick, earlier tracks may be incomplete.
    known_from: Tick,
    gaps: PacketGaps,
    fec_decoder: FecDecoder,
    scene_events: u64,
    /// The count of scene events in the datagram of the newest tick.
    counted_events: u64,
    /// Set for an edge.
    relayed_packets: Option<RelayedPackets>,
    /// Heads and bodies of datagrams that wait for scene events.
    deferred: VecDeque<(Head, Vec<u8>)>,
    /// Number of datagrams that have come.
    arrived: u64,
    /// Indices of attached bodies, and of some that were attached earlier.
    attached_indices: Vec<u32>,
    aliases: ReceivedAliases,
    watermark_tick: Tick,
    converged_at: Tick,
    newest: Tick,
    /// The tick of the newest packet with updates.
    newest_update: Tick,
    lost_sync: bool,
    /// True if a checksum of the publisher differs from that of the tracks.
    mismatched: bool,
    /// True if the snapshot is complete; until then datagrams wait.
    placed: bool,
    /// Indices changed since the last drain, each once, and a mark for each index among them.
    changed: Vec<u32>,
    marked: Vec<bool>,
    updates: Vec<Update>,
    /// Set for an untrusted publisher: indices and aliases are below this bound, and no body is attached.
    restricted: Option<u32>,
    /// Set for a stream with a budget: its statements of the error scale.
    statements: Option<ErrorScaleLog>,
    statistics: SubscriberStatistics,
}

impl Subscriber {
    /// A subscriber whose snapshot, with everything up to `start.tick`, is about to arrive.
    #[must_use]
    pub fn new(start: &StreamStart) -> Self {
        Self {
            stream: start.stream,
            largest_packet: start.largest_packet,
            tracks: Tracks::new(
                start.tolerance,
                start.integrator,
                start.publish_interval,
                start.gravity,
            ),
            start: start.tick,
            publish_interval: start.publish_interval,
            first: start.next,
            earlier_tracks: EarlierTracks::default(),
            lifetimes: Lifetimes::default(),
            silent_publishers: SilentPublishers::default(),
            shown: None,
            history: 0,
            lookahead: Ticks::ZERO,
            stepping: Stepping::FreeRunning,
            known_from: Tick::ZERO,
            gaps: PacketGaps::new(start.next),
            fec_decoder: FecDecoder::new(start.next, start.largest_packet),
            scene_events: start.scene_events,
            counted_events: start.scene_events,
            relayed_packets: None,
            deferred: VecDeque::new(),
            arrived: 0,
            attached_indices: Vec::new(),
            aliases: ReceivedAliases::default(),
            watermark_tick: start.tick,
            converged_at: start.tick,
            newest: start.tick,
            newest_update: start.tick,
            lost_sync: false,
            mismatched: false,
            placed: false,
            changed: Vec::new(),
            marked: Vec::new(),
            updates: Vec::new(),
            restricted: None,
            statements: None,
            statistics: SubscriberStatistics::default(),
        }
    }

    /// A subscriber whose stream has indices and aliases below `end` and no attached bodies, so that the peer cannot
    /// make tables longer.
    #[must_use]
    pub(crate) fn restricted(start: &StreamStart, end: u32) -> Self {
        Self {
            restricted: Some(end),
            ..Self::new(start)
        }
    }

    /// A subscriber to a stream with a budget, which may exceed its tolerances and states by how much.
    #[must_use]
    pub fn limited(start: &StreamStart) -> Self {
        Self {
            statements: Some(ErrorScaleLog::new(start.next, start.tick)),
            ..Self::new(start)
        }
    }

    /// The factor by which tolerances may be exceeded at a tick: one, unless the stream has a budget that did not
    /// suffice. `None` if a stream with a budget has not stated it.
    #[must_use]
    pub fn error_scale_at(&self, tick: Tick) -> Option<f64> {
        self.statements
            .as_ref()
            .map_or(Some(1.0), |log| log.at(tick))
    }

    /// The number of datagrams that have come, whatever they said.
    pub(crate) const fn arrived(&self) -> u64 {
        self.arrived
    }

    /// True if a datagram waits for scene events that have not arrived.
    pub(crate) fn waits_for_scene_events(&self) -> bool {
        self.placed && !self.deferred.is_empty()
    }

    /// The number of missing packets.
    #[must_use]
    pub fn missing(&self) -> usize {
        self.gaps.missing().count()
    }

    /// The numbers of the missing packets, in rising order.
    pub fn missing_packets(&self) -> impl Iterator<Item = u64> + Clone {
        self.gaps.missing()
    }

    /// The id of the stream.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.stream
    }

    /// The tolerance of a body with the usual scale.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.tracks.tolerance()
    }

    /// The tolerance of a body, by its tolerance scale.
    #[must_use]
    pub fn tolerance_of(&self, id: BodyId) -> Option<Tolerance> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| self.tracks.tolerance_of(slot))
    }

    /// Counters of everything received so far.
    #[must_use]
    pub const fn statistics(&self) -> SubscriberStatistics {
        self.statistics
    }

    /// The newest tick up to which the publisher has sent everything.
    #[must_use]
    pub const fn watermark_tick(&self) -> Tick {
        self.watermark_tick
    }

    /// The number of silent ticks up to the watermark. A free-running stream states its watermark again before its
    /// silence has doubled, or two and a half seconds later (PROTOCOL 6.4).
    #[must_use]
    pub const fn silent_ticks(&self) -> u64 {
        self.watermark_tick
            .value()
            .saturating_sub(self.newest_update.value())
    }

    /// The newest tick at which every body is within its tolerance.
    #[must_use]
    pub fn complete(&self) -> Tick {
        if self.is_converged() && self.known_from <= self.watermark_tick {
            self.watermark_tick
        } else {
            self.converged_at
        }
    }

    /// The tick from which on all motions up to the watermark are known, while no packet is missing.
    pub(crate) const fn known_from(&self) -> Tick {
        self.known_from
    }

    /// True if no packet is missing or unread.
    #[must_use]
    pub fn is_converged(&self) -> bool {
        self.placed && self.gaps.is_converged() && self.deferred.is_empty() && !self.lost_sync
    }

    /// True if only a new snapshot helps: too many packets are missing, or a checksum differs.
    #[must_use]
    pub const fn has_lost_sync(&self) -> bool {
        self.lost_sync
    }

    /// True if a checksum differs: a fault of the publisher or of the subscriber.
    #[must_use]
    pub const fn has_mismatched(&self) -> bool {
        self.mismatched
    }

    /// One more than the highest index that any body had.
    #[must_use]
    pub fn index_end(&self) -> usize {
        self.tracks.len()
    }

    /// The body with this index; None if there is none.
    #[must_use]
    pub fn body(&self, index: u32) -> Option<BodyId> {
        self.tracks.slot(index).map(|slot| slot.id(index))
    }

    /// The tick of the snapshot: nothing is known of the ticks before it.
    #[must_use]
    pub const fn start(&self) -> Tick {
        self.start
    }

    /// True if no view asks for ticks before this one any more, as far as one is expected to be behind a tick up to which all
    /// is complete.
    pub(crate) fn is_shown_from(&self, tick: Tick, complete: Tick) -> bool {
        let is_shown = self.shown.is_none_or(|shown| shown.from >= tick);
        let behind = complete.value().saturating_sub(tick.value());
        tick <= complete && (is_shown || behind > EXPECTED_HISTORY)
    }

    /// How the scene steps.
    pub(crate) const fn stepping(&self) -> Stepping {
        self.stepping
    }

    /// True for a body that is there, and one that has gone and that a view may still show.
    pub(crate) fn knows(&self, id: BodyId) -> bool {
        self.body(id.index()) == Some(id) || self.lifetimes.has_departed(id)
    }

    /// The label that a body was placed with.
    pub(crate) fn label(&self, id: BodyId) -> Option<u32> {
        let slot = self.tracks.slot(id.index())?;
        self.tracks
            .label(slot)
            .filter(|_| slot.id(id.index()) == id)
    }

    /// The track of a body.
    #[must_use]
    pub fn track(&self, id: BodyId) -> Option<Track> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| slot.track())
    }

    /// The published motion of a body's track at its origin; in the frame of its parent if it has one.
    #[must_use]
    pub fn published_motion(&self, id: BodyId) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| slot.track().start(self.tracks.grid(slot)))
    }

    /// True if a body's track lies still in the world frame: see [`Track::is_resting`].
    #[must_use]
    pub fn is_resting(&self, id: BodyId) -> Option<bool> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| slot.dense().is_resting())
    }

    /// The motion of a body at a tick by this track, its present or previous one.
    pub(crate) fn predicted(&self, id: BodyId, track: &Track, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| self.tracks.framed_fresh(slot, track, tick))
    }

    /// True if the stream publishes at a tick.
    fn is_published(&self, tick: Tick) -> bool {
        tick == self.start
            || tick
                .value()
                .is_multiple_of(u64::from(self.publish_interval.get()))
    }

    /// The first published tick after this one.
    fn published_after(&self, tick: Tick) -> Tick {
        let interval = u64::from(self.publish_interval.get());
        Tick::new(tick.value() - tick.value() % interval + interval)
    }

    /// The last published tick before this one.
    fn published_before(&self, tick: Tick) -> Tick {
        let before = tick.value().saturating_sub(1);
        Tick::new(before - before % u64::from(self.publish_interval.get()))
    }

    /// Moves the indices of bodies that were placed, removed or updated since the last call into `out`, in no order,
    /// each once.
    pub fn drain_changed(&mut self, out: &mut Vec<u32>) {
        for index in &self.changed {
            self.marked[*index as usize] = false;
        }
        if out.is_empty() {
            // The caller's buffer has the capacity for the next changes.
            core::mem::swap(out, &mut self.changed);
        } else {
            out.append(&mut self.changed);
        }
    }

    /// True if a body was placed or updated since the last call of [`Self::drain_changed`].
    #[must_use]
    pub fn has_changed(&self, id: BodyId) -> bool {
        let marked = self.marked.get(id.index() as usize);
        marked.copied().unwrap_or_default()
    }

    /// Counts an index as changed.
    fn note_changed(&mut self, index: u32) {
        let place = index as usize;
        grow_to(&mut self.marked, place + 1, || false);
        if !core::mem::replace(&mut self.marked[place], true) {
            push(&mut self.changed, index);
        }
    }

    /// Counts attached bodies as changed if their parents changed.
    fn note_attached_changed(&mut self) {
        let mut attached = core::mem::take(&mut self.attached_indices);
        attached.retain(|index| {
            let Some(parent) = self.tracks.slot(*index).and_then(Slot::parent) else {
                return false;
            };
            let moved = self.marked.get(parent.index() as usize);
            if moved.copied().unwrap_or_default() {
                self.note_changed(*index);
            }
            true
        });
        self.attached_indices = attached;
    }

    /// Replaces another replica of the same scene: every index of that one and of those that it replaced counts as
    /// changed, and its mismatches are added.
    pub(crate) fn succeed(&mut self, old: &Self) {
        let end = old.index_end().max(old.marked.len());
        for index in 0..end as u32 {
            self.note_changed(index);
        }
        self.statistics.mismatches += old.statistics.mismatches;
    }

    /// Places a body after a scene event; `false` if that exceeds a limit.
    #[must_use]
    pub fn place(&mut self, id: BodyId, parameters: &PredictionParameters, track: Track) -> bool {
        self.place_labelled(id, parameters, track, self.label(id))
    }

    /// As [`Self::place`], with a label of the caller that many bodies may share.
    #[must_use]
    pub(crate) fn place_labelled(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        label: Option<u32>,
    ) -> bool {
        let since = self.first_shown(track.origin);
        self.place_since(id, (parameters, track), label, since)
    }

    /// As [`Self::place_labelled`], for a body that was elsewhere before and is here from the origin of its track on.
    #[must_use]
    pub(crate) fn place_arrived(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        label: Option<u32>,
    ) -> bool {
        self.place_since(id, (parameters, track), label, track.origin)
    }

    fn place_since(
        &mut self,
        id: BodyId,
        (parameters, track): (&PredictionParameters, Track),
        label: Option<u32>,
        since: Tick,
    ) -> bool {
        let label_before = self.body(id.index()).and_then(|before| self.label(before));
        let departed = self.depart(id.index(), Some(since));
        let mut placed = self.tracks.place(id, parameters, track, label);
        if !placed && self.forget_departed() {
            // The publisher no longer has them, so they must not take a damping's place from its bodies.
            placed = self.tracks.place(id, parameters, track, label);
        }
        if placed {
            if !departed {
                self.lifetimes.release_label(label_before);
            }
            self.arrive_at(id, since);
            self.aliases.clear(id.index());
            if track.parent.is_some() {
                self.attached_indices.push(id.index());
            }
            self.note_changed(id.index());
            self.earlier_tracks.forget(id.index());
        }
        placed
    }

    /// Assigns an alias that a body had before the snapshot.
    pub fn alias(&mut self, id: BodyId, alias: u32) {
        if id.index() < INDICES_MAX && alias < INDICES_MAX {
            self.aliases
                .take(alias, id.index(), self.newest, AliasOwner::AsAssigned);
        }
    }

    /// Removes a body after a scene event; `false` if there is no such body.
    #[must_use]
    pub fn remove(&mut self, id: BodyId) -> bool {
        self.remove_at(id, None)
    }

    /// The same of a body that is gone from a tick on; `None`: the first datagram that counts the scene event tells it.
    #[must_use]
    pub(crate) fn remove_at(&mut self, id: BodyId, tick: Option<Tick>) -> bool {
        self.note_changed(id.index());
        if self.body(id.index()) != Some(id) {
            return false;
        }
        let label = self.label(id);
        if !self.depart(id.index(), tick) {
            self.lifetimes.release_label(label);
            self.silent_publishers.forget(id);
        }
        self.earlier_tracks.forget(id.index());
        self.aliases.clear(id.index());
        self.tracks.remove(id)
    }

    /// Changes the gravity after a scene event.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
        let falling = self
            .tracks
            .iter()
            .filter(|(_, slot)| slot.origin() >= since);
        let falling: Vec<u32> = falling.map(|(index, _)| index).collect();
        for index in falling {
            self.note_changed(index);
        }
    }

    /// Notes after a scene event that the poses of bodies are guesses from a tick on, because their publisher is
    /// silent.
    pub(crate) fn silence(&mut self, since: Tick, bodies: &[BodyId]) {
        for id in bodies {
            self.silent_publishers.silence(*id, since);
        }
    }

    /// Notes after a scene event that the publisher of bodies is active again from a tick on.
    pub(crate) fn confirm(&mut self, tick: Tick, bodies: &[BodyId]) {
        for id in bodies {
            self.silent_publishers.confirm(*id, tick);
        }
    }

    /// Notes that a scene event was applied, and reads datagrams that waited for it.
    pub fn apply_scene_event(&mut self) {
        self.scene_events += 1;
        self.read_deferred();
    }

    /// Notes that the snapshot is complete, and reads datagrams that waited for it.
    pub fn handle_snapshot_end(&mut self) {
        self.placed = true;
        self.read_deferred();
    }

    fn read_deferred(&mut self) {
        for _ in 0..self.deferred.len() {
            if let Some((head, body)) = self.deferred.pop_front() {
                self.read(&Datagram::opened(head, &body));
            }
        }
        self.note_converged();
    }

    /// Applies a datagram with its head. A malformed one, or one of another stream, only changes a counter.
    pub fn handle_datagram(&mut self, datagram: &[u8]) {
        match Datagram::open(datagram) {
            Ok(datagram) => self.handle(&datagram),
            Err(_) => self.statistics.malformed += 1,
        }
    }

    /// Applies a datagram of this stream. A malformed one, or one of another stream, only changes a counter.
    pub fn handle(&mut self, datagram: &Datagram<'_>) {
        self.arrived += 1;
        self.read(datagram);
        self.note_converged();
    }

    fn note_converged(&mut self) {
        self.converged_at = self.complete();
    }

    /// Drops earlier tracks that ended by this tick, as far as no packet is missing: the caller needs no motions before
    /// it, and all those from it on. A [`bound`](Self::bound_at) at an earlier tick may be unknown from now on.
    pub fn forget_before(&mut self, tick: Tick) {
        let end = tick.min(self.converged_at);
        let tracks = &self.tracks;
        self.earlier_tracks
            .forget_until(end, |index| tracks.slot(index).map(Slot::origin));
        self.shown = Some(ShownPast {
            from: tick,
            behind: self.newest.value().saturating_sub(tick.value()),
        });
        let (lifetimes, tracks) = (&mut self.lifetimes, &mut self.tracks);
        let news_after = match self.stepping {
            // A scene that stands still has no news: it comes with the next tick.
            Stepping::Lockstep => None,
            Stepping::FreeRunning => {
                let until_published = u64::from(self.publish_interval.get()) - 1;
                Some(self.history + u64::from(self.lookahead.count()) + until_published)
            }
        };
        lifetimes.forget_before(tick, news_after, |slot| tracks.release(slot));
        let is_there = |id: BodyId| {
            let slot = tracks.slot(id.index());
            slot.is_some_and(|slot| slot.id(id.index()) == id)
        };
        let is_known = |id| is_there(id) || lifetimes.has_departed(id);
        self.silent_publishers.forget_before(tick, is_known);
    }

    /// Keeps, until a view says what it needs, what one from the snapshot on may show: bodies that have gone, and when others
    /// came.
    pub(crate) const fn expect_view(&mut self) {
        self.shown = Some(ShownPast {
            from: self.start,
            behind: 0,
        });
        self.history = EXPECTED_HISTORY;
    }

    /// Keeps motions for this many ticks before the newest one, because a view is delayed by them. What is
    /// older than the last [`Self::forget_before`] is dropped all the same.
    pub const fn set_history(&mut self, ticks: Ticks) {
        self.history = ticks.count() as u64;
    }

    /// The checksum over all tracks.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.tracks.state_checksum()
    }

    /// The number of packets since the start that did not arrive by themselves, recovered ones included (PROTOCOL
    /// 5.13).
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.gaps.next() - self.first - self.gaps.arrived()
    }

    /// The loss report with the oldest missing packets.
    #[must_use]
    pub fn loss_report(&self) -> LossReport {
        self.loss_report_of(self.gaps.missing())
    }

    /// The loss report with only these of the missing packets, in rising order.
    #[must_use]
    pub(crate) fn loss_report_for(&self, requested: &[u64]) -> LossReport {
        let missing = self.gaps.missing();
        self.loss_report_of(missing.filter(|number| requested.binary_search(number).is_ok()))
    }

    fn loss_report_of(&self, missing: impl Iterator<Item = u64> + Clone) -> LossReport {
        let repair_symbols = self.fec_decoder.wanted(missing.clone(), self.gaps.next());
        // An unread packet is applied once its missing packet is known, so it needs no refresh.
        let is_waiting =
            |number: &u64| repair_symbols > 0 && self.fec_decoder.source_symbol(*number).is_some();
        let lost = missing.filter(|number| !is_waiting(number));
        LossReport {
            next: Low16::of(self.gaps.next()),
            abandoned: Low16::of(self.lost()),
            repair_symbols,
            lost: lost
                .take(crate::limits::LOST_NUMBERS_MAX)
                .map(Low16::of)
                .collect(),
        }
    }
}

/// Ticks by which the first view of a copy may be behind the newest tick.
const EXPECTED_HISTORY: u64 = 256;

/// Counters of a subscriber.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SubscriberStatistics {
    /// Packets that arrived after a packet that was sent later.
    pub disordered: u64,
    /// Packets of this stream that were read, recovered ones included.
    pub packets: u64,
    /// Updates applied.
    pub updates: u64,
    /// Datagrams received twice.
    pub duplicates: u64,
    /// Datagrams that are malformed.
    pub malformed: u64,
    /// Packets found missing.
    pub missed: u64,
    /// Repair symbols received.
    pub repair_symbols: u64,
    /// Packets recovered from repair symbols.
    pub rebuilt: u64,
    /// Parts of refreshes applied.
    pub refreshes: u64,
    /// Updates that built on a missing packet.
    pub unread: u64,
    /// Packets dropped because too many waited for scene events.
    pub overflowed: u64,
    /// Checksums compared with the publisher's.
    pub compared: u64,
    /// Mismatches among them: a fault of the publisher or of the subscriber. A new snapshot follows.
    pub mismatches: u64,
}

/// The distance between a body's copied and true pose at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ErrorBound {
    /// Every point of the body is within this distance of its true place.
    ///
    /// This includes a body at its exact rest pose: it may have woken since and moved less than the tolerance.
    Within(Metres),
    /// Nothing finite is known: a packet that may contain an update of the body is missing, or what the server knows of
    /// the moment has not arrived. A body may be anywhere then, because a command may have placed it there.
    Unknown {
        /// The newest tick up to which the stream was complete.
        since: Tick,
    },
}

impl ErrorBound {
    /// The bound as a length; infinite if it is not known.
    #[must_use]
    pub const fn metres(&self) -> f64 {
        match self {
            Self::Within(distance) => distance.metres(),
            Self::Unknown { .. } => f64::INFINITY,
        }
    }
}

impl fmt::Display for ErrorBound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Within(distance) => write!(f, "within {} m", distance.metres()),
            Self::Unknown { since } => write!(f, "not known since {since}"),
        }
    }
}
