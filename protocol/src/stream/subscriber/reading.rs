//! How a subscriber reads its datagrams: what each kind changes.
//!
//! Everything is decoded before anything is believed; what cannot be read is counted, never guessed.

use rhumb_reckoning::{DenseTrack, Predictor, Quartet, Tick};

use super::Subscriber;
use crate::limits::{PACKETS_HELD_MAX, TICK_JUMP_MAX};
use crate::packet::{
    Digest, Excess, FullPacket, Head, Kind, Low16, Parity, Ranges, Repair, RepairRecord, Saying,
    StatePacket, TrackSaying, Update, Vouch,
};
use crate::stream::gaps::{Arrival, RepairOf};
use crate::stream::seats::Sitter;
use crate::stream::tracks::{Abreast, Former, Slot, Unreadable};
use crate::wire::bytes::Reader;
use crate::wire::{Malformed, Wire};

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
        if self.missing() > 0
            && self.older.len() < OLDER_KEPT
            && let Some(before) = self.before.get(index)
        {
            self.older.push((index, DenseTrack::new(&before)));
        }
    }

    /// Takes in what a packet says of a body.
    fn take(&mut self, index: u32, tick: Tick, saying: &Saying) -> Result<(), Unreadable> {
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
        let carrier = self.tracks.slot(index).and_then(Slot::carrier);
        if carrier.is_some() && before.is_none_or(|before| before.carrier().is_none()) {
            self.held_indices.push(index);
        }
        self.note_heard(index, before);
        Ok(())
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

    pub(super) fn read(&mut self, datagram: &[u8]) {
        if self.try_read(datagram).is_err() {
            self.statistics.malformed += 1;
        }
        self.remember_seats();
    }

    /// While something is missing it is remembered who sits where.
    fn remember_seats(&mut self) {
        if !self.gaps.is_settled() {
            self.seats.remember();
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
            Kind::StateInArrears if self.statements.is_some() => {
                self.read_state(datagram, StatePacket::decode_in_arrears(reader)?)
            }
            Kind::Vouch => self.read_vouch(datagram, Vouch::decode(reader)?, Some(Excess::NONE)),
            Kind::VouchInArrears if self.statements.is_some() => {
                let (vouch, excess) = Vouch::decode_in_arrears(reader)?;
                self.read_vouch(datagram, vouch, Some(excess))
            }
            Kind::Repair => self.read_repair(datagram, &Repair::decode(reader)?),
            Kind::Digest => self.read_digest(datagram, &Digest::decode(reader)?),
            Kind::Parity => {
                self.read_parity(Parity::decode(reader)?);
                Ok(())
            }
            Kind::Echo | Kind::Doubt | Kind::StateInArrears | Kind::VouchInArrears => {
                return Err(Malformed::UnknownCode);
            }
        }?;
        self.rebuild();
        Ok(())
    }

    /// Whether the notices that a datagram builds on were heard; if not, keeps it for later.
    fn is_due(&mut self, notices: Low16, datagram: &[u8]) -> bool {
        if self.placed && notices.expand(self.notices) <= self.notices {
            return true;
        }
        if self.narrow.is_none() && self.held.len() < PACKETS_HELD_MAX {
            self.held.push_back(datagram.to_vec());
        } else {
            self.statistics.overflowed += 1;
        }
        false
    }

    pub(super) fn tick_of(&self, tick: Low16) -> Tick {
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
        self.statistics.disordered += u64::from(number < next);
        self.statistics.missed += number.saturating_sub(next);
        self.newest = self.newest.max(tick);
        self.spoken = self.spoken.max(tick);
        let whole = if ends_tick {
            tick
        } else {
            self.spoken_before(tick)
        };
        self.vouched = self.vouched.max(whole);
        Some((number, tick))
    }

    pub(super) fn read_state(
        &mut self,
        datagram: &[u8],
        packet: StatePacket<'_>,
    ) -> Result<(), Malformed> {
        // Everything is decoded before anything is believed, or kept for later (PROTOCOL 6.5).
        let mut updates = core::mem::take(&mut self.updates);
        let (number, tick, ends_tick) = (packet.number, packet.tick, packet.ends_tick);
        let excess = ends_tick.then_some(packet.excess);
        let notices = packet.notices;
        let decoded = packet
            .updates(&mut updates)
            .and_then(|()| self.admit(&updates));
        let newest = self.gaps.next();
        if decoded.is_ok()
            && self.is_due(notices, datagram)
            && let Some((number, tick)) = self.arrive(number, tick, ends_tick)
        {
            if let Some(statements) = &mut self.statements {
                statements.packet(number, tick, excess);
            }
            self.keep(number, datagram);
            self.remember_seats();
            self.hear_all(number, tick, &updates);
            if number < newest {
                self.read_again_after(number, &mut updates);
            }
            self.touch_held();
        }
        self.updates = updates;
        decoded
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

    /// Refuses what a narrow stream cannot say.
    fn admit(&self, updates: &[Update]) -> Result<(), Malformed> {
        let Some(end) = self.narrow else {
            return Ok(());
        };
        let fits = |update: &Update| {
            let held = matches!(&update.saying, Saying::Whole(whole) if whole.carrier.is_some());
            let named = update.body.is_none_or(|body| body < end) && update.seat < end;
            named && !held && !update.saying.names_carrier()
        };
        if updates.iter().all(fits) {
            Ok(())
        } else {
            Err(Malformed::OutOfRange)
        }
    }

    /// The same of a repair.
    fn admit_repair(&self, repair: &Repair) -> Result<(), Malformed> {
        let Some(end) = self.narrow else {
            return Ok(());
        };
        let fits = |record: &RepairRecord| {
            let named = record.index < end && record.seat.is_none_or(|seat| seat < end);
            named && record.whole.carrier.is_none()
        };
        if repair.records.iter().all(fits) {
            Ok(())
        } else {
            Err(Malformed::OutOfRange)
        }
    }

    /// A body, as it was said to sit somewhere at a tick.
    fn sitter(&self, index: u32, tick: Tick) -> Sitter {
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
                carrier: None,
            });
            // Removed or said anew since: what came later stands.
            let _ = self.take(record.index, tick, &saying);
        }
        Ok(())
    }

    /// `excess`: what it says of how far tracks exceed their tolerances, if it says anything of that.
    fn read_vouch(
        &mut self,
        datagram: &[u8],
        vouch: Vouch,
        excess: Option<Excess>,
    ) -> Result<(), Malformed> {
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
        if let (Some(statements), Some(excess)) = (&mut self.statements, excess) {
            statements.vouch(next, tick, excess);
        }
        self.statistics.missed += next.saturating_sub(before);
        self.newest = self.newest.max(tick);
        self.vouched = self.vouched.max(tick);
        Ok(())
    }

    /// Sums over tracks vouch, and can be compared if nothing was heard or missed since.
    fn read_digest(&mut self, datagram: &[u8], digest: &Digest) -> Result<(), Malformed> {
        if !self.is_due(digest.notices, datagram) {
            return Ok(());
        }
        let (next, tick, notices) = (digest.next, digest.tick, digest.notices);
        self.read_vouch(
            datagram,
            Vouch {
                next,
                tick,
                notices,
            },
            None,
        )?;
        let same_packets = next.expand(self.gaps.next()) == self.gaps.next();
        let same_notices = notices.expand(self.notices) == self.notices;
        let known = self.held.is_empty() && !self.lost_touch && self.gaps.is_settled();
        if !(same_packets && same_notices && known) {
            return Ok(());
        }
        self.statistics.compared += 1;
        if self.doubts.compare(&self.tracks, digest) && digest.ranges == Ranges::ALL {
            self.statistics.mismatches += 1;
        }
        Ok(())
    }

    /// Takes the publisher's track of the body that is doubted, whatever is believed here.
    fn amend(&mut self, as_of: Tick, repair: &Repair) -> Result<(), Malformed> {
        let Some(index) = self.doubts.index() else {
            return Ok(());
        };
        for record in repair.records.iter().filter(|record| record.index == index) {
            let origin = as_of.before(record.age).ok_or(Malformed::OutOfRange)?;
            if self.tracks.set_track(index, record.whole.track(origin)) {
                self.seats.dismiss(index);
                self.lose_before(index);
                self.touch(index);
                self.statistics.amended += 1;
                self.amended.extend(self.body(index));
            }
        }
        self.doubts.end();
        Ok(())
    }

    fn read_repair(&mut self, datagram: &[u8], repair: &Repair) -> Result<(), Malformed> {
        self.admit_repair(repair)?;
        if !self.is_due(repair.notices, datagram) {
            return Ok(());
        }
        let as_of = self.tick_of(repair.tick);
        if self.jumps(as_of) {
            self.lost_touch = true;
            return Ok(());
        }
        let lost = repair.lost.expand(self.gaps.next());
        if lost >= self.gaps.next() {
            return self.amend(as_of, repair);
        }
        self.statistics.repairs += 1;
        self.seats.repair(as_of);
        for record in &repair.records {
            let Some(origin) = as_of.before(record.age) else {
                return Err(Malformed::OutOfRange);
            };
            let whole = Saying::Whole(record.whole);
            // A seat that was missed must not make one body's next update another's.
            let sitter = self.sitter(record.index, as_of);
            match record.seat {
                Some(seat) => self.seats.take(seat, record.index, as_of, sitter),
                None => self.seats.leave_by(record.index, as_of),
            }
            let holder = self.tracks.slot(record.index).and_then(Slot::carrier);
            if self
                .tracks
                .hear(record.index, origin, &whole, Former::default())
                .is_ok()
            {
                if record.whole.carrier.is_some() && holder.is_none() {
                    self.held_indices.push(record.index);
                }
                self.touch(record.index);
            }
            self.lose_before(record.index);
        }
        let of = RepairOf {
            as_of,
            notices: repair.notices.expand(self.notices),
            parts: repair.parts,
        };
        self.gaps.repaired(lost, of, repair.part);
        let mut updates = core::mem::take(&mut self.updates);
        self.read_again_after(lost, &mut updates);
        self.updates = updates;
        self.touch_held();
        Ok(())
    }
}
