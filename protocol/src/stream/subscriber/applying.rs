//! The subscriber applies updates, and resolves aliases to bodies.

use rhumb_reckoning::{BodyId, DenseTrack, PredictionX4, Tick};

use super::Subscriber;
use crate::packet::{Update, UpdatePayload};
use crate::stream::aliases::AliasOwner;
use crate::stream::tracks::{CorrectionsX4, Slot, Unreadable};

impl Subscriber {
    /// Applies an update that a newer one has overtaken: its track held until the newer one.
    ///
    /// Of a restricted stream, more than two tracks of a body may be in use. The track that held between them is then
    /// no longer known.
    fn apply_late(&mut self, index: u32, tick: Tick, payload: &UpdatePayload) {
        if self.restricted.is_some() {
            return self.doubt_earlier(index, Tick::ZERO);
        }
        let present = self.tracks.slot(index).map(Slot::origin);
        let earlier = self.earlier_tracks.at(index, tick);
        let has_earlier = earlier.is_some_and(|earlier| earlier.track.origin < tick);
        if !has_earlier || present.is_none_or(|origin| origin <= tick) {
            return;
        }
        match payload {
            UpdatePayload::Keyframe(keyframe) => {
                let track = DenseTrack::new(&keyframe.track(tick));
                self.earlier_tracks.insert(index, track, self.shown_from());
            }
            UpdatePayload::Residual { .. } | UpdatePayload::Resting { .. } => {
                self.doubt_earlier(index, Tick::new(tick.value().saturating_sub(1)));
            }
        }
    }

    /// Notes that the earlier tracks of a body may be incomplete after a tick. Without a view they are dropped.
    pub(super) fn doubt_earlier(&mut self, index: u32, after: Tick) {
        let Some(origin) = self.tracks.slot(index).map(Slot::origin) else {
            return;
        };
        match self.shown {
            Some(_) => self.earlier_tracks.doubt_after(index, after),
            None => self.earlier_tracks.forget(index),
        }
        self.known_from = self.known_from.max(origin);
    }

    /// Keeps a track that another one has replaced, as long as a view shows ticks of it.
    fn keep_earlier(&mut self, index: u32, before: DenseTrack) {
        let shown_from = self.shown_from();
        self.earlier_tracks.keep(index, before, shown_from);
    }

    /// Applies a payload to a body.
    pub(super) fn take(
        &mut self,
        index: u32,
        tick: Tick,
        payload: &UpdatePayload,
    ) -> Result<(), Unreadable> {
        let before = self.tracks.slot(index).map(|slot| *slot.dense());
        let result = self.tracks.apply(index, tick, payload);
        if result == Err(Unreadable::Superseded) {
            self.apply_late(index, tick, payload);
        }
        result?;
        self.note_attached(index, before.and_then(|before| before.parent()));
        self.note_applied(index, before);
        Ok(())
    }

    /// Applies a record of a refresh: the body may have had other tracks since the stream was converged.
    pub(super) fn apply_record(&mut self, index: u32, origin: Tick, payload: &UpdatePayload) {
        let before = self.tracks.slot(index).map(|slot| *slot.dense());
        if self.tracks.apply(index, origin, payload).is_ok() {
            self.note_attached(index, before.and_then(|before| before.parent()));
            if let Some(before) = before {
                self.keep_earlier(index, before);
            }
            self.touch(index);
        }
        self.doubt_earlier(index, self.converged_at);
    }

    /// Notes a body that became attached.
    pub(super) fn note_attached(&mut self, index: u32, before: Option<BodyId>) {
        let parent = self.tracks.slot(index).and_then(Slot::parent);
        if parent.is_some() && before.is_none() {
            self.attached_indices.push(index);
        }
    }

    /// Notes that a body has another track.
    fn note_applied(&mut self, index: u32, before: Option<DenseTrack>) {
        match before {
            Some(before) => self.keep_earlier(index, before),
            None => self.earlier_tracks.forget(index),
        }
        self.statistics.updates += 1;
        // The receiver of a restricted stream sees only the newest track if one datagram brings several.
        let again = self.marked.get(index as usize).copied().unwrap_or_default();
        if self.restricted.is_some() && again {
            self.doubt_earlier(index, Tick::ZERO);
        }
        self.touch(index);
    }

    /// Applies all updates of a packet.
    pub(super) fn apply_all(&mut self, number: u64, tick: Tick, updates: &[Update]) {
        // A child is decoded relative to its parent's track after the same packet.
        let mut batch = CorrectionsX4::default();
        let mut framed = false;
        for update in updates {
            if update.payload.names_parent() {
                framed = true;
            } else {
                self.apply(number, tick, update, &mut batch);
            }
        }
        self.apply_batch(tick, &mut batch);
        if !framed {
            return;
        }
        for update in updates {
            if update.payload.names_parent() {
                self.apply(number, tick, update, &mut batch);
            }
        }
    }

    /// Applies the corrections whose predictions were computed together.
    fn apply_batch(&mut self, tick: Tick, batch: &mut CorrectionsX4<'_>) {
        let mut applied = [None; PredictionX4::LANES];
        let mut places = applied.iter_mut();
        self.tracks.apply_batch(batch, tick, |index, before| {
            if let Some(place) = places.next() {
                *place = Some((index, before));
            }
        });
        for (index, before) in applied.into_iter().flatten() {
            self.note_applied(index, Some(before));
        }
    }

    /// The state of the body of an alias assignment at a tick.
    pub(super) fn owner(&self, index: u32, tick: Tick) -> AliasOwner {
        match self.tracks.slot(index) {
            Some(slot) if slot.origin() <= tick => AliasOwner::AsAssigned,
            _ => AliasOwner::Newer,
        }
    }

    /// Applies an update of one body, at once or with the next batch.
    fn apply<'a>(
        &mut self,
        number: u64,
        tick: Tick,
        update: &'a Update,
        batch: &mut CorrectionsX4<'a>,
    ) {
        if let Some(body) = update.body {
            if batch.has(body) {
                self.apply_batch(tick, batch);
            }
            let owner = self.owner(body, tick);
            self.aliases.take(update.alias, body, tick, owner);
        }
        let sits = || self.aliases.body_since(update.alias, tick);
        let Some(index) = update.body.or_else(sits) else {
            self.statistics.unread += 1;
            self.gaps.note_unread(number, tick, false);
            return;
        };
        if batch.has(index) {
            self.apply_batch(tick, batch);
        }
        if self.tracks.enqueue_x4(batch, index, tick, &update.payload) {
            if batch.is_full() {
                self.apply_batch(tick, batch);
            }
            return;
        }
        match self.take(index, tick, &update.payload) {
            Ok(()) => {}
            Err(Unreadable::OtherRevision) => {
                self.statistics.unread += 1;
                self.gaps.note_unread(number, tick, true);
            }
            // Refreshes of earlier missing packets need not contain this body.
            Err(Unreadable::OtherParentRevision) => {
                self.statistics.unread += 1;
                self.gaps.note_unread(number, tick, false);
            }
            // The body was removed or has a newer track, which stays.
            Err(Unreadable::NoBody | Unreadable::Superseded) => {}
        }
    }
}
