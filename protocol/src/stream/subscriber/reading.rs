//! How a subscriber reads its datagrams: what each kind changes.
//!
//! Everything is decoded before anything is believed; what cannot be read is counted, never guessed.

use rhumb_reckoning::{Predictor, Tick};

use super::Subscriber;
use crate::limits::{PACKETS_HELD_MAX, TICK_JUMP_MAX};
use crate::packet::{
    Digest, Excess, FullPacket, Head, Kind, Low16, Parity, Ranges, Repair, RepairRecord, Saying,
    StatePacket, TrackSaying, Update, Vouch,
};
use crate::stream::gaps::{Arrival, RepairOf};
use crate::stream::tracks::{Former, Slot};
use crate::wire::bytes::Reader;
use crate::wire::{Malformed, Wire};

impl Subscriber {
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

    /// Whether a repair may be the answer to the doubt about one body. Of a packet that is known to have been sent it came
    /// too late, and makes nothing good; what is a repair after all comes again when nothing is doubted any more.
    fn may_amend(&self, repair: &Repair) -> bool {
        let doubted = self.doubts.index();
        let of_it = |record: &RepairRecord| Some(record.index) == doubted && record.seat.is_none();
        doubted.is_some() && repair.parts == 1 && repair.records.iter().all(of_it)
    }

    /// Takes the publisher's track of the body that is doubted, whatever is believed here.
    fn amend(&mut self, as_of: Tick, repair: &Repair) -> Result<(), Malformed> {
        let Some(index) = self.doubts.index() else {
            return Ok(());
        };
        for record in repair.records.iter().filter(|record| record.index == index) {
            let origin = as_of.before(record.age).ok_or(Malformed::OutOfRange)?;
            let holder = self.tracks.slot(index).and_then(Slot::carrier);
            if self.tracks.set_track(index, record.whole.track(origin)) {
                self.note_held(index, holder);
                self.seats.dismiss(index);
                self.older.retain(|(of, _)| *of != index);
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
            self.amend(as_of, repair)?;
        } else if self.gaps.lacks(lost) && !self.may_amend(repair) {
            self.make_good(lost, as_of, repair)?;
        }
        self.touch_held();
        Ok(())
    }

    /// Takes in a repair of a packet that is missing. One of a packet that was heard says nothing that is not known, or is
    /// the answer to a doubt, which came too late.
    fn make_good(&mut self, lost: u64, as_of: Tick, repair: &Repair) -> Result<(), Malformed> {
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
                self.note_held(record.index, holder);
                self.touch(record.index);
            }
            self.lose_before(record.index);
        }
        let of = RepairOf {
            as_of,
            notices: repair.notices.expand(self.notices),
            parts: repair.parts,
        };
        if self.gaps.repaired(lost, of, repair.part) {
            let mut updates = core::mem::take(&mut self.updates);
            self.read_again_after(lost, &mut updates);
            self.updates = updates;
        }
        Ok(())
    }
}
