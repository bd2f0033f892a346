//! How a subscriber takes in what is said of bodies, and whom it means.

use rhumb_reckoning::{BodyId, DenseTrack, PredictionX4, Tick};

use super::Subscriber;
use crate::packet::{Update, UpdatePayload};
use crate::stream::aliases::AliasOwner;
use crate::stream::tracks::{CorrectionsX4, Slot, Unreadable};

impl Subscriber {
    /// Takes in what was overtaken by a newer payload: it is what attached until then.
    ///
    /// Of a restricted stream more than two tracks of a body may be in use: what attached between them is not known any more.
    fn apply_late(&mut self, index: u32, tick: Tick, payload: &UpdatePayload) {
        if self.restricted.is_some() {
            return self.drop_previous(index);
        }
        let Some(before) = self.before.origin(index) else {
            return;
        };
        let present = self.tracks.slot(index).map(Slot::origin);
        if before >= tick || present.is_none_or(|origin| origin <= tick) {
            return;
        }
        match payload {
            UpdatePayload::Keyframe(keyframe) => self
                .before
                .keep(index, DenseTrack::new(&keyframe.track(tick))),
            UpdatePayload::Residual { .. } | UpdatePayload::Resting { .. } => {
                self.drop_previous(index)
            }
        }
    }

    /// Of what a body did before its present track, too little was heard.
    pub(super) fn drop_previous(&mut self, index: u32) {
        if let Some(origin) = self.tracks.slot(index).map(Slot::origin) {
            self.before.forget(index);
            self.known_from = self.known_from.max(origin);
        }
    }

    /// Takes in what a packet says of a body.
    pub(super) fn take(
        &mut self,
        index: u32,
        tick: Tick,
        payload: &UpdatePayload,
    ) -> Result<(), Unreadable> {
        let before = self.tracks.slot(index).map(|slot| *slot.dense());
        let heard = self.tracks.apply(index, tick, payload);
        if heard == Err(Unreadable::Superseded) {
            self.apply_late(index, tick, payload);
        }
        heard?;
        self.note_attached(index, before.and_then(|before| before.parent()));
        self.note_applied(index, before);
        Ok(())
    }

    /// Notes a body that another holds now, if none did before.
    pub(super) fn note_attached(&mut self, index: u32, before: Option<BodyId>) {
        let parent = self.tracks.slot(index).and_then(Slot::parent);
        if parent.is_some() && before.is_none() {
            self.attached_indices.push(index);
        }
    }

    /// A body has another track than it had before.
    fn note_applied(&mut self, index: u32, before: Option<DenseTrack>) {
        match before {
            Some(before) => self.before.keep(index, before),
            None => self.before.forget(index),
        }
        self.statistics.updates += 1;
        // Who follows a restricted stream learns of the newest track only, where one datagram brings several.
        let again = self.marked.get(index as usize).copied().unwrap_or_default();
        if self.restricted.is_some() && again {
            self.drop_previous(index);
        }
        self.touch(index);
    }

    /// Takes in all that a packet says.
    pub(super) fn apply_all(&mut self, number: u64, tick: Tick, updates: &[Update]) {
        // What is attached is read by where its parent_candidate is said to be in the same packet.
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

    /// Takes in what waits to be reckoned side by side.
    fn apply_batch(&mut self, tick: Tick, batch: &mut CorrectionsX4<'_>) {
        let mut heard = [None; PredictionX4::LANES];
        let mut places = heard.iter_mut();
        self.tracks.apply_batch(batch, tick, |index, before| {
            if let Some(place) = places.next() {
                *place = Some((index, before));
            }
        });
        for (index, before) in heard.into_iter().flatten() {
            self.note_applied(index, Some(before));
        }
    }

    /// A body, as it was said to sit somewhere at a tick.
    pub(super) fn owner(&self, index: u32, tick: Tick) -> AliasOwner {
        match self.tracks.slot(index) {
            Some(slot) if slot.origin() <= tick => AliasOwner::AsAssigned,
            _ => AliasOwner::MovedOn,
        }
    }

    /// Takes in what is said of one body, at once or with the next ones.
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
            // Removed or said anew since: what came later stands.
            Err(Unreadable::NoBody | Unreadable::Superseded) => {}
        }
    }
}
