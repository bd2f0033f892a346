//! How a subscriber takes in what is said of bodies, and whom it means.

use rhumb_reckoning::{BodyId, DenseTrack, Quartet, Tick};

use super::Subscriber;
use crate::packet::{Saying, Update};
use crate::stream::seats::Sitter;
use crate::stream::tracks::{Abreast, Former, Slot, Unreadable};

/// Tracks that bodies left while packets were missing: what a long gap of a lively scene takes.
const OLDER_KEPT: usize = 4_096;

impl Subscriber {
    /// Takes in what was overtaken by a newer saying: it is what held until then.
    ///
    /// Of a narrow stream more than two tracks of a body may be in use: what held between them is not known any more.
    fn take_overtaken(&mut self, index: u32, tick: Tick, saying: &Saying) {
        if self.narrow.is_some() {
            return self.lose_before(index);
        }
        let Some(before) = self.before.origin(index) else {
            return;
        };
        let present = self.tracks.slot(index).map(Slot::origin);
        if before >= tick || present.is_none_or(|origin| origin <= tick) {
            return;
        }
        match saying {
            Saying::Whole(whole) => self.before.keep(index, DenseTrack::new(&whole.track(tick))),
            Saying::Residual { .. } | Saying::Settled { .. } => self.lose_before(index),
        }
    }

    /// Of what a body did before its present track, too little was heard.
    pub(super) fn lose_before(&mut self, index: u32) {
        if let Some(origin) = self.tracks.slot(index).map(Slot::origin) {
            self.before.forget(index);
            self.known_from = self.known_from.max(origin);
        }
    }

    /// While a packet is missing that may name it, the track is kept that a body had before its last one.
    fn grow_older(&mut self, index: u32) {
        if self.missing_packets().next().is_some()
            && self.older.len() < OLDER_KEPT
            && let Some(before) = self.before.get(index)
        {
            self.older.push((index, DenseTrack::new(&before)));
        }
    }

    /// Takes in what a packet says of a body.
    pub(super) fn take(
        &mut self,
        index: u32,
        tick: Tick,
        saying: &Saying,
    ) -> Result<(), Unreadable> {
        let before = self.tracks.slot(index).map(|slot| *slot.dense());
        let former = Former {
            before: Some(&self.before),
            older: &self.older,
        };
        let heard = self.tracks.hear(index, tick, saying, former);
        if heard == Err(Unreadable::Superseded) {
            self.take_overtaken(index, tick, saying);
        }
        heard?;
        self.note_held(index, before.and_then(|before| before.carrier()));
        self.note_heard(index, before);
        Ok(())
    }

    /// Notes a body that another holds now, if none did before.
    pub(super) fn note_held(&mut self, index: u32, before: Option<BodyId>) {
        let carrier = self.tracks.slot(index).and_then(Slot::carrier);
        if carrier.is_some() && before.is_none() {
            self.held_indices.push(index);
        }
    }

    /// A body has another track than it had before.
    fn note_heard(&mut self, index: u32, before: Option<DenseTrack>) {
        self.grow_older(index);
        match before {
            Some(before) => self.before.keep(index, before),
            None => self.before.forget(index),
        }
        self.statistics.updates += 1;
        // Who follows a narrow stream learns of the newest track only, where one datagram brings several.
        let again = self.marked.get(index as usize).copied().unwrap_or_default();
        if self.narrow.is_some() && again {
            self.lose_before(index);
        }
        self.touch(index);
    }

    /// Takes in all that a packet says.
    pub(super) fn hear_all(&mut self, number: u64, tick: Tick, updates: &[Update]) {
        // What is held is read by where its holder is said to be in the same packet.
        let mut abreast = Abreast::default();
        let mut framed = false;
        for update in updates {
            if update.saying.names_carrier() {
                framed = true;
            } else {
                self.hear(number, tick, update, &mut abreast);
            }
        }
        self.hear_abreast(tick, &mut abreast);
        if !framed {
            return;
        }
        for update in updates {
            if update.saying.names_carrier() {
                self.hear(number, tick, update, &mut abreast);
            }
        }
    }

    /// Takes in what waits to be reckoned side by side.
    fn hear_abreast(&mut self, tick: Tick, abreast: &mut Abreast<'_>) {
        let mut heard = [None; Quartet::LANES];
        let mut places = heard.iter_mut();
        self.tracks.hear_abreast(abreast, tick, |index, before| {
            if let Some(place) = places.next() {
                *place = Some((index, before));
            }
        });
        for (index, before) in heard.into_iter().flatten() {
            self.note_heard(index, Some(before));
        }
    }

    /// A body, as it was said to sit somewhere at a tick.
    pub(super) fn sitter(&self, index: u32, tick: Tick) -> Sitter {
        match self.tracks.slot(index) {
            Some(slot) if slot.origin() <= tick => Sitter::AsSaid,
            _ => Sitter::GoneOn,
        }
    }

    /// Takes in what is said of one body, at once or with the next ones.
    fn hear<'a>(&mut self, number: u64, tick: Tick, update: &'a Update, abreast: &mut Abreast<'a>) {
        if let Some(body) = update.body {
            if abreast.has(body) {
                self.hear_abreast(tick, abreast);
            }
            let sitter = self.sitter(body, tick);
            self.seats.take(update.seat, body, tick, sitter);
        }
        // Who sits there now may not be who was meant then.
        let sits = || self.seats.body_since(update.seat, tick);
        let sat = || {
            let whole = !self.gaps.lacks_before(number);
            whole.then(|| self.seats.body_then(update.seat, tick))?
        };
        let Some(index) = update.body.or_else(sits).or_else(sat) else {
            self.statistics.unread += 1;
            self.gaps.could_not_read(number, tick, false);
            return;
        };
        if abreast.has(index) {
            self.hear_abreast(tick, abreast);
        }
        if self
            .tracks
            .await_abreast(abreast, index, tick, &update.saying)
        {
            if abreast.is_full() {
                self.hear_abreast(tick, abreast);
            }
            return;
        }
        let taken = self.take(index, tick, &update.saying);
        let rests = |slot: &Slot| slot.origin() == tick && slot.is_verbatim_rest();
        if self.tracks.slot(index).is_some_and(rests) {
            self.seats.leave(index, tick);
        }
        match taken {
            Ok(()) => {}
            Err(Unreadable::OtherRevision) => {
                self.statistics.unread += 1;
                self.gaps.could_not_read(number, tick, true);
            }
            // Removed or said anew since: what came later stands.
            Err(Unreadable::NoBody | Unreadable::Superseded) => {}
        }
    }
}
