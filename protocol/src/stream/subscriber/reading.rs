//! The subscriber reads each kind of datagram.
//!
//! A datagram is decoded completely before it is applied. A malformed one is counted and never guessed at.

use alloc::vec::Vec;

use rhumb_reckoning::{Predictor, Tick};

use super::Subscriber;
use crate::limits::{TICK_JUMP_MAX, WAITING_DATAGRAMS_MAX};
use crate::packet::{
    Checksums, Datagram, ErrorScale, FullPacket, Keyframe, Low16, PacketKind, Refresh,
    RefreshRecord, RepairSymbol, Update, UpdatePacket, UpdatePayload, Watermark,
};
use crate::stream::gaps::{Arrival, PacketArrival, RefreshId};
use crate::wire::Malformed;

impl Subscriber {
    pub(super) fn read(&mut self, datagram: &Datagram<'_>) {
        // Only a new snapshot helps (PROTOCOL 6.7-10).
        if self.lost_sync {
            return;
        }
        if self.try_read(datagram).is_err() {
            self.statistics.malformed += 1;
        }
    }

    fn try_read(&mut self, datagram: &Datagram<'_>) -> Result<(), Malformed> {
        let (head, reader) = (datagram.head(), datagram.body());
        if head.stream != self.stream {
            return Err(Malformed::UnknownCode);
        }
        if datagram.byte_len() > self.largest_packet.bytes() {
            return Err(Malformed::TooLong);
        }
        match head.kind {
            PacketKind::Updates => {
                self.read_arrived(datagram, UpdatePacket::decode(false, reader)?)
            }
            PacketKind::UpdatesEnd => {
                self.read_arrived(datagram, UpdatePacket::decode(true, reader)?)
            }
            PacketKind::Full => self.read_full(datagram, &FullPacket::decode(false, reader)?),
            PacketKind::FullEnd => self.read_full(datagram, &FullPacket::decode(true, reader)?),
            PacketKind::UpdatesOverBudget if self.statements.is_some() => {
                self.read_arrived(datagram, UpdatePacket::decode_over_budget(reader)?)
            }
            PacketKind::Watermark => {
                self.read_watermark(datagram, Watermark::decode(reader)?, Some(ErrorScale::NONE))
            }
            PacketKind::WatermarkOverBudget if self.statements.is_some() => {
                let (watermark, error_scale) = Watermark::decode_over_budget(reader)?;
                self.read_watermark(datagram, watermark, Some(error_scale))
            }
            PacketKind::Refresh => self.read_refresh(datagram, &Refresh::decode(reader)?),
            PacketKind::Checksums => self.read_checksums(datagram, &Checksums::decode(reader)?),
            PacketKind::RepairSymbol => {
                self.read_repair_symbol(RepairSymbol::decode(reader)?);
                Ok(())
            }
            PacketKind::LossReport
            | PacketKind::UpdatesOverBudget
            | PacketKind::WatermarkOverBudget => {
                return Err(Malformed::UnknownCode);
            }
        }?;
        self.rebuild();
        Ok(())
    }

    /// True if the scene events that a datagram builds on were received; if not, the datagram is kept for later.
    fn is_due(&mut self, scene_events: Low16, datagram: &Datagram<'_>) -> bool {
        if self.placed && scene_events.expand(self.scene_events) <= self.scene_events {
            return true;
        }
        if self.restricted.is_none() && self.deferred.len() < WAITING_DATAGRAMS_MAX {
            let body = datagram.body().rest().to_vec();
            self.deferred.push_back((datagram.head(), body));
        } else {
            self.statistics.overflowed += 1;
        }
        false
    }

    pub(super) fn tick_of(&self, tick: Low16) -> Tick {
        Tick::new(tick.expand(self.newest.value()))
    }

    /// True if a tick lies so far ahead that the stream must start again.
    fn jumps(&self, tick: Tick) -> bool {
        tick.value() > self.newest.value() + TICK_JUMP_MAX
    }

    /// Counts a numbered packet, and returns its number and tick if it is to be read.
    fn arrive(
        &mut self,
        (number, tick): (Low16, Low16),
        ends_tick: bool,
        how: Arrival,
    ) -> Option<(u64, Tick)> {
        let number = number.expand(self.gaps.next());
        let tick = self.tick_of(tick);
        let next = self.gaps.next();
        if self.jumps(tick) {
            self.lost_sync = true;
            return None;
        }
        match self.gaps.arrive(number, tick, how) {
            PacketArrival::Fresh => {}
            PacketArrival::Duplicate => {
                self.statistics.duplicates += 1;
                return None;
            }
            PacketArrival::Lost => {
                self.lost_sync = true;
                return None;
            }
        }
        self.statistics.packets += 1;
        self.statistics.disordered += u64::from(number < next);
        self.statistics.missed += number.saturating_sub(next);
        self.newest = self.newest.max(tick);
        self.newest_update = self.newest_update.max(tick);
        let keyframe = if ends_tick {
            tick
        } else {
            self.published_before(tick)
        };
        self.watermark_tick = self.watermark_tick.max(keyframe);
        Some((number, tick))
    }

    fn read_arrived(
        &mut self,
        datagram: &Datagram<'_>,
        packet: UpdatePacket<'_>,
    ) -> Result<(), Malformed> {
        self.read_state(datagram, packet, Arrival::ByItself)
    }

    pub(super) fn read_state(
        &mut self,
        datagram: &Datagram<'_>,
        packet: UpdatePacket<'_>,
        how: Arrival,
    ) -> Result<(), Malformed> {
        // Everything is decoded before it is applied, or kept for later (PROTOCOL 6.5).
        let mut updates = core::mem::take(&mut self.updates);
        let (number, tick, ends_tick) = (packet.number, packet.tick, packet.ends_tick);
        let error_scale = ends_tick.then_some(packet.error_scale);
        let scene_events = packet.scene_events;
        let decoded = packet
            .updates(&mut updates)
            .and_then(|()| self.admit(&updates));
        let newest = self.gaps.next();
        if decoded.is_ok()
            && self.is_due(scene_events, datagram)
            && let Some((number, tick)) = self.arrive((number, tick), ends_tick, how)
        {
            if let Some(statements) = &mut self.statements {
                statements.packet(number, tick, error_scale);
            }
            self.note_departures(scene_events, tick);
            self.keep(number, datagram);
            self.apply_all(number, tick, &updates);
            if number < newest {
                self.read_again_after(number, &mut updates);
            }
            self.touch_attached();
        }
        self.updates = updates;
        decoded
    }

    /// Refuses updates that a restricted stream must not contain.
    fn admit(&self, updates: &[Update]) -> Result<(), Malformed> {
        let Some(end) = self.restricted else {
            return Ok(());
        };
        let fits = |update: &Update| {
            let attached = matches!(&update.payload, UpdatePayload::Keyframe(keyframe) if keyframe.parent.is_some());
            let named = update.body.is_none_or(|body| body < end) && update.alias < end;
            named && !attached && !update.payload.names_parent()
        };
        if updates.iter().all(fits) {
            Ok(())
        } else {
            Err(Malformed::OutOfRange)
        }
    }

    /// Refuses a refresh that a restricted stream must not contain.
    fn admit_refresh(&self, refresh: &Refresh) -> Result<(), Malformed> {
        let Some(end) = self.restricted else {
            return Ok(());
        };
        let fits = |record: &RefreshRecord| {
            let named = record.index < end && record.alias.is_none_or(|alias| alias < end);
            named && record.keyframe.parent.is_none()
        };
        if refresh.records.iter().all(fits) {
            Ok(())
        } else {
            Err(Malformed::OutOfRange)
        }
    }

    fn read_full(&mut self, datagram: &Datagram<'_>, packet: &FullPacket) -> Result<(), Malformed> {
        if !self.is_due(packet.scene_events, datagram) {
            return Ok(());
        }
        let of = (packet.number, packet.tick);
        let Some((_, tick)) = self.arrive(of, packet.ends_tick, Arrival::ByItself) else {
            return Ok(());
        };
        self.note_departures(packet.scene_events, tick);
        for record in &packet.records {
            let payload = UpdatePayload::Keyframe(Keyframe {
                predictor: Predictor::Uniform,
                anchor: rhumb_reckoning::Anchor::Exact(record.motion),
                parent: None,
            });
            // The body was removed or has a newer state, which stays.
            let _ = self.take(record.index, tick, &payload);
        }
        Ok(())
    }

    /// `error_scale`: the factor by which tracks exceed their tolerances, if the watermark states one.
    fn read_watermark(
        &mut self,
        datagram: &Datagram<'_>,
        watermark: Watermark,
        error_scale: Option<ErrorScale>,
    ) -> Result<(), Malformed> {
        if !self.is_due(watermark.scene_events, datagram) {
            return Ok(());
        }
        let tick = self.tick_of(watermark.tick);
        let before = self.gaps.next();
        let next = watermark.next.expand(before);
        if self.jumps(tick) || !self.gaps.announce(next, tick) {
            self.lost_sync = true;
            return Ok(());
        }
        if let (Some(statements), Some(error_scale)) = (&mut self.statements, error_scale) {
            statements.watermark(next, tick, error_scale);
        }
        // It may have been sent between its tick and the next one.
        self.note_departures(watermark.scene_events, tick.next());
        self.statistics.missed += next.saturating_sub(before);
        self.newest = self.newest.max(tick);
        self.watermark_tick = self.watermark_tick.max(tick);
        Ok(())
    }

    /// A checksum is also a watermark. It is compared if all packets before it were received and none after it.
    fn read_checksums(
        &mut self,
        datagram: &Datagram<'_>,
        checksums: &Checksums,
    ) -> Result<(), Malformed> {
        if !self.is_due(checksums.scene_events, datagram) {
            return Ok(());
        }
        let (next, tick, scene_events) = (checksums.next, checksums.tick, checksums.scene_events);
        self.read_watermark(
            datagram,
            Watermark {
                next,
                tick,
                scene_events,
            },
            None,
        )?;
        let same_packets = next.expand(self.gaps.next()) == self.gaps.next();
        let same_scene_events = scene_events.expand(self.scene_events) == self.scene_events;
        let is_certain = self.deferred.is_empty() && !self.lost_sync && self.gaps.is_converged();
        if !(same_packets && same_scene_events && is_certain) {
            return Ok(());
        }
        self.statistics.compared += 1;
        if checksums.sum != self.tracks.settle_checksum() {
            self.statistics.mismatches += 1;
            (self.mismatched, self.lost_sync) = (true, true);
        }
        Ok(())
    }

    fn read_refresh(
        &mut self,
        datagram: &Datagram<'_>,
        refresh: &Refresh,
    ) -> Result<(), Malformed> {
        self.admit_refresh(refresh)?;
        if !self.is_due(refresh.scene_events, datagram) {
            return Ok(());
        }
        let as_of = self.tick_of(refresh.tick);
        if self.jumps(as_of) {
            self.lost_sync = true;
            return Ok(());
        }
        let records = refresh.records.iter();
        let origins: Option<Vec<Tick>> = records.map(|record| as_of.before(record.age)).collect();
        let origins = origins.ok_or(Malformed::OutOfRange)?;
        let lost = refresh.lost.expand(self.gaps.next());
        if self.gaps.lacks(lost) {
            self.make_good(lost, as_of, refresh, &origins);
        }
        self.touch_attached();
        Ok(())
    }

    /// Applies a refresh of a missing packet. A refresh of a received packet contains nothing new.
    fn make_good(&mut self, lost: u64, as_of: Tick, refresh: &Refresh, origins: &[Tick]) {
        self.statistics.refreshes += 1;
        for (record, origin) in refresh.records.iter().zip(origins.iter().copied()) {
            let keyframe = UpdatePayload::Keyframe(record.keyframe);
            // Without a missed alias assignment, a body's next update would apply to the wrong body.
            let owner = self.owner(record.index, as_of);
            match record.alias {
                Some(alias) => self.aliases.take(alias, record.index, as_of, owner),
                None => self.aliases.release_by(record.index, as_of),
            }
            self.apply_record(record.index, origin, &keyframe);
        }
        let of = RefreshId {
            as_of,
            scene_events: refresh.scene_events.expand(self.scene_events),
            parts: refresh.parts,
        };
        if self.gaps.refreshed(lost, of, refresh.part) {
            let mut updates = core::mem::take(&mut self.updates);
            self.read_again_after(lost, &mut updates);
            self.updates = updates;
        }
    }
}
