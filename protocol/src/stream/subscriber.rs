//! Follows a stream: keeps its tracks, and knows which of them to trust.
//!
//! Bytes from anyone: nothing heard may panic, and memory is bounded by the limits. Does not choose when to ask for
//! refresh; see the client's session. Invariant: while the stream is converged, every track equals the publisher's.

mod applying;
mod predicting;
mod reading;
mod rebuilding;

use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Metres, Motion, Tick, Tolerance, Track, attached_motion};

use super::aliases::{AliasOwner, ReceivedAliases};
use super::bound::ErrorBound;
use super::error_scale_log::ErrorScaleLog;
use super::fec_decoder::FecDecoder;
use super::gaps::PacketGaps;
use super::previous_tracks::PreviousTracks;
use super::start::StreamStart;
use super::statistics::SubscriberStatistics;
use super::tracks::{PredictionParameters, Slot, Tracks};
use crate::capacity::{grow_to, push};
use crate::limits::INDICES_MAX;
use crate::packet::{Datagram, Head, LossReport, Low16, StreamId, Update};

/// One stream at its listener.
#[derive(Clone, Debug)]
pub struct Subscriber {
    stream: StreamId,
    tracks: Tracks,
    /// The snapshot's tick.
    start: Tick,
    publish_interval: NonZeroU32,
    /// The number of the first packet.
    first: u64,
    /// The tracks before the present ones, where nothing was said between the two.
    before: PreviousTracks,
    /// The newest origin of a track before which too little of its body was heard.
    known_from: Tick,
    gaps: PacketGaps,
    fec_decoder: FecDecoder,
    scene_events: u64,
    /// Heads and bodies of datagrams that must wait until more scene_events were heard.
    deferred: VecDeque<(Head, Vec<u8>)>,
    /// Indices of bodies that others hold, and of some that these attached once.
    attached_indices: Vec<u32>,
    aliases: ReceivedAliases,
    watermark_tick: Tick,
    converged_at: Tick,
    newest: Tick,
    /// The tick of the newest packet that said something.
    newest_update: Tick,
    lost_sync: bool,
    /// Whether a checksum of the publisher differs from that of the tracks.
    mismatched: bool,
    /// Whether the snapshot is keyframe; until then datagrams wait.
    placed: bool,
    /// Indices that changed since they were last drained, each once, and whether each index is among them.
    changed: Vec<u32>,
    marked: Vec<bool>,
    updates: Vec<Update>,
    /// Of a stream whose source is not trusted with more: indices and aliases stay below it, and no body holds another.
    restricted: Option<u32>,
    /// Of a stream with a budget, what it says of how far it exceeds its tolerances.
    statements: Option<ErrorScaleLog>,
    statistics: SubscriberStatistics,
}

impl Subscriber {
    /// A stream of which everything up to `tick` will be placed by the snapshot now arriving.
    ///
    /// `next`: number of the first packet after the snapshot. `scene_events`: how many the snapshot includes.
    #[must_use]
    pub fn new(start: &StreamStart) -> Self {
        Self {
            stream: start.stream,
            tracks: Tracks::new(
                start.tolerance,
                start.integrator,
                start.publish_interval,
                start.gravity,
            ),
            start: start.tick,
            publish_interval: start.publish_interval,
            first: start.next,
            before: PreviousTracks::default(),
            known_from: Tick::ZERO,
            gaps: PacketGaps::new(start.next),
            fec_decoder: FecDecoder::new(start.next),
            scene_events: start.scene_events,
            deferred: VecDeque::new(),
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

    /// The same of a stream whose bodies and aliases have numbers below `end` and hold one another never, so that no peer
    /// makes tables longer.
    #[must_use]
    pub(crate) fn restricted(start: &StreamStart, end: u32) -> Self {
        Self {
            restricted: Some(end),
            ..Self::new(start)
        }
    }

    /// The same of a stream with a budget, which may exceed its tolerances and says by how much.
    #[must_use]
    pub fn limited(start: &StreamStart) -> Self {
        Self {
            statements: Some(ErrorScaleLog::new(start.next, start.tick)),
            ..Self::new(start)
        }
    }

    /// The factor by which tolerances may be exceeded at a tick: one, unless the stream has a budget that did not suffice;
    /// `None` where a stream with a budget was not heard to say it.
    #[must_use]
    pub fn error_scale_at(&self, tick: Tick) -> Option<f64> {
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

    /// Its promise for a body: by the body's tolerance_scale.
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
    pub const fn watermark_tick(&self) -> Tick {
        self.watermark_tick
    }

    /// For how many ticks up to the watermark_tick one nothing was said. A stream that runs freely watermarks again before it has
    /// been silent for twice as long, or for two and a half seconds more (PROTOCOL 6.4).
    #[must_use]
    pub const fn silent_ticks(&self) -> u64 {
        self.watermark_tick
            .value()
            .saturating_sub(self.newest_update.value())
    }

    /// The newest tick at which the promise holds for every body.
    #[must_use]
    pub fn complete(&self) -> Tick {
        if self.is_converged() && self.known_from <= self.watermark_tick {
            self.watermark_tick
        } else {
            self.converged_at
        }
    }

    /// The tick from which on everything is known, up to the watermark_tick one, while nothing is missing.
    pub(crate) const fn known_from(&self) -> Tick {
        self.known_from
    }

    /// Whether nothing is missing.
    #[must_use]
    pub fn is_converged(&self) -> bool {
        self.placed && self.gaps.is_converged() && self.deferred.is_empty() && !self.lost_sync
    }

    /// Whether only a new snapshot helps: too many packets are missing, or a checksum differs.
    #[must_use]
    pub const fn has_lost_sync(&self) -> bool {
        self.lost_sync
    }

    /// Whether a checksum differs: a fault of the publisher or of the subscriber.
    #[must_use]
    pub const fn has_mismatched(&self) -> bool {
        self.mismatched
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

    /// What is predicted_motion of a body at a tick: by its track, or before that one's origin by the track before.
    #[must_use]
    pub fn predicted_motion(&self, id: BodyId, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        if slot.id(id.index()) != id {
            return None;
        }
        let present = slot.track();
        let track = self.track_at(id.index(), &present, tick);
        let track = track.unwrap_or(present);
        let motion = self.tracks.framed((id.index(), slot), &track, tick);
        let Some((index, parent)) = self.tracks.parent(&track) else {
            return Some(motion);
        };
        let present = parent.track();
        let attached_to = self.track_at(index, &present, tick).unwrap_or(present);
        let by = self.tracks.framed((index, parent), &attached_to, tick);
        Some(attached_motion(&by, &motion.pose()))
    }

    /// What a track of a body, this one or one that it had, says of a tick.
    pub(crate) fn predicted(&self, id: BodyId, track: &Track, tick: Tick) -> Option<Motion> {
        let slot = self.tracks.slot(id.index())?;
        (slot.id(id.index()) == id).then(|| self.tracks.framed_fresh(slot, track, tick))
    }

    /// Which of a body's last two tracks attached at a tick, as far as is known.
    fn track_at(&self, index: u32, track: &Track, tick: Tick) -> Option<Track> {
        if track.origin <= tick {
            return Some(*track);
        }
        let before = self.before.get(index);
        before.filter(|before| before.origin <= tick)
    }

    /// How far off the copy of a body may be at the watermark_tick tick.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.bound_at(id, self.watermark_tick)
    }

    /// How far off the copy of a body may be at a tick; unknown for one that is not watermark_tick for yet, that lies before the
    /// tracks that are still attached, or between two ticks that are newest_update of.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        let track = self.track(id)?;
        let slot = self.tracks.slot(id.index())?;
        let since = self.converged_at;
        let doubted = self.gaps.unsure_before();
        let in_doubt = |track: &Track| doubted.is_some_and(|before| track.origin < before);
        let sure = |index: u32, track: &Track| {
            let attached = self.track_at(index, track, tick);
            attached.filter(|attached| !in_doubt(attached))
        };
        let known = sure(id.index(), &track).is_some_and(|then| match then.parent {
            None => true,
            // What is attached is known as well as its parent_candidate.
            Some(_) => self
                .tracks
                .parent(&then)
                .is_some_and(|(index, parent)| sure(index, &parent.track()).is_some()),
        });
        if tick > self.watermark_tick || !self.is_published(tick) || self.lost_sync || !known {
            return Some(ErrorBound::Unknown { since });
        }
        let Some(error_scale) = self.error_scale_at(tick) else {
            return Some(ErrorBound::Unknown { since });
        };
        let reach = self
            .tracks
            .tolerance_of(slot)
            .reach(self.tracks.radius(slot));
        Some(ErrorBound::Within(Metres::new(
            reach.metres() * error_scale,
        )))
    }

    /// Whether the promise is about a tick.
    fn is_published(&self, tick: Tick) -> bool {
        tick == self.start
            || tick
                .value()
                .is_multiple_of(u64::from(self.publish_interval.get()))
    }

    /// The last tick before this one that the promise is about.
    fn published_before(&self, tick: Tick) -> Tick {
        let before = tick.value().saturating_sub(1);
        Tick::new(before - before % u64::from(self.publish_interval.get()))
    }

    /// TierPolicy the indices of bodies that came, went or were updated since the last call into `out`, in no order,
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

    /// Counts what is attached as changed where its parent_candidate is.
    fn touch_attached(&mut self) {
        let mut attached = core::mem::take(&mut self.attached_indices);
        attached.retain(|index| {
            let Some(parent) = self.tracks.slot(*index).and_then(Slot::parent) else {
                return false;
            };
            let moved = self.marked.get(parent.index() as usize);
            if moved.copied().unwrap_or_default() {
                self.touch(*index);
            }
            true
        });
        self.attached_indices = attached;
    }

    /// Replaces another copy of the same scene: every index of that copy counts as changed, and its mismatches are added.
    pub(crate) fn succeed(&mut self, old: &Self) {
        for index in 0..old.index_end() as u32 {
            self.touch(index);
        }
        self.statistics.mismatches += old.statistics.mismatches;
    }

    /// A scene_event placed a body; `false` when that breaks a limit.
    #[must_use]
    pub fn place(&mut self, id: BodyId, parameters: &PredictionParameters, track: Track) -> bool {
        self.place_labelled(id, parameters, track, self.label(id))
    }

    /// The same with a label, a number of the caller's own that many bodies may share; the other keeps it.
    #[must_use]
    pub(crate) fn place_labelled(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        label: Option<u32>,
    ) -> bool {
        let placed = self.tracks.place(id, parameters, track, label);
        if placed {
            self.aliases.clear(id.index());
            if track.parent.is_some() {
                self.attached_indices.push(id.index());
            }
            self.touch(id.index());
            self.before.forget(id.index());
        }
        placed
    }

    /// A body has a alias already, as a late listener is told.
    pub fn alias(&mut self, id: BodyId, alias: u32) {
        if id.index() < INDICES_MAX && alias < INDICES_MAX {
            self.aliases
                .take(alias, id.index(), self.newest, AliasOwner::AsAssigned);
        }
    }

    /// A scene_event took a body out; `false` when it is not there.
    #[must_use]
    pub fn remove(&mut self, id: BodyId) -> bool {
        self.touch(id.index());
        let removed = self.tracks.remove(id);
        if removed {
            self.aliases.clear(id.index());
        }
        removed
    }

    /// A scene_event changed the gravity.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.tracks.change_gravity(since, gravity);
    }

    /// A scene_event was heard and taken in; datagrams that waited for it are read now.
    pub fn apply_scene_event(&mut self) {
        self.scene_events += 1;
        self.read_deferred();
    }

    /// The snapshot is keyframe; datagrams that waited for it are read now.
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

    /// Takes in a datagram of which the head was not read yet. One that is malformed or of another stream changes nothing but a
    /// count.
    pub fn handle_datagram(&mut self, datagram: &[u8]) {
        match Datagram::open(datagram) {
            Ok(datagram) => self.handle(&datagram),
            Err(_) => self.statistics.malformed += 1,
        }
    }

    /// Takes in a datagram of this stream. One that is malformed or of another stream changes nothing but a count.
    pub fn handle(&mut self, datagram: &Datagram<'_>) {
        self.read(datagram);
        self.note_converged();
    }

    fn note_converged(&mut self) {
        self.converged_at = self.complete();
    }

    /// Nobody asks any more what was predicted_motion at a tick before this one: tracks that bodies left by then, as far as
    /// everything was heard, are kept no longer. A [`bound`](Self::bound_at) at such a tick may be unknown from now on.
    pub fn forget_before(&mut self, tick: Tick) {
        let end = tick.min(self.converged_at);
        let tracks = &self.tracks;
        self.before
            .retain(|index| tracks.slot(index).is_some_and(|slot| slot.origin() > end));
    }

    /// The sum over all tracks, by which two ends can be compared.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.tracks.state_checksum().value()
    }

    /// How many of the packets that are known to have been sent did not come by themselves, since this began.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        let heard = self.statistics.packets - self.statistics.rebuilt;
        (self.gaps.next() - self.first).saturating_sub(heard)
    }

    /// What to tell the server: how far this has heard, and the oldest packets that are missing.
    #[must_use]
    pub fn loss_report(&self) -> LossReport {
        self.loss_report_of(self.gaps.missing())
    }

    /// The same, naming only these of the missing packets, in rising order.
    #[must_use]
    pub fn loss_report_for(&self, asked: &[u64]) -> LossReport {
        let missing = self.gaps.missing();
        self.loss_report_of(missing.filter(|number| asked.binary_search(number).is_ok()))
    }

    fn loss_report_of(&self, missing: impl Iterator<Item = u64> + Clone) -> LossReport {
        let repair_symbols = self.fec_decoder.wanted(missing.clone(), self.gaps.next());
        // What was heard is read as soon as what it waits for is there.
        let waits =
            |number: &u64| repair_symbols > 0 && self.fec_decoder.source_symbol(*number).is_some();
        let lost = missing.filter(|number| !waits(number));
        LossReport {
            next: Low16::of(self.gaps.next()),
            gone: Low16::of(self.lost()),
            repair_symbols,
            lost: lost
                .take(crate::limits::LOST_NAMED_MAX)
                .map(Low16::of)
                .collect(),
        }
    }
}
