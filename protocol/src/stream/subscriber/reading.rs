//! Datagrams of a subscriber: read and applied; made again for an edge.
//!
//! A datagram is decoded completely before it is applied. A malformed one is counted and never guessed at. Packets
//! that build on a missing one wait for it.
//!
//! An edge forwards the packets of a stream as they are. Its subscriber has the publisher's tracks, so that it makes
//! snapshots, refreshes and watermarks in the publisher's place. Encodes no updates, and knows no receivers. Invariant:
//! what it says is true of the publisher's stream at the tick that it names, so it speaks only while it is settled.

use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, DenseTrack, Predictor, Tick};

use super::Subscriber;
use crate::limits::{FEC_SPAN, TICK_JUMP_MAX, WAITING_DATAGRAMS_MAX};
use crate::packet::{
    Checksums, Datagram, ErrorScale, FullPacket, Keyframe, LargestPacket, Low16, PacketKind,
    Refresh, RefreshRecord, RefreshWriter, RepairSymbol, Update, UpdatePacket, UpdatePayload,
    Watermark, packet_of,
};
use crate::stream::aliases::AliasOwner;
use crate::stream::gaps::{Arrival, PacketArrival, RefreshId};
use crate::stream::tracks::{CorrectionsX4, Slot, Unreadable};
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

    fn tick_of(&self, tick: Low16) -> Tick {
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
        if let Some(relayed_packets) = &mut self.relayed_packets {
            relayed_packets.note_packet(number);
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

    fn read_state(
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
            self.note_attached_changed();
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
        let Some((number, tick)) = self.arrive(of, packet.ends_tick, Arrival::ByItself) else {
            return Ok(());
        };
        self.note_departures(packet.scene_events, tick);
        for record in &packet.records {
            let payload = UpdatePayload::Keyframe(Keyframe {
                predictor: Predictor::Uniform,
                anchor: rhumb_reckoning::Anchor::Exact(record.motion),
                parent: None,
            });
            self.note_relayed(number, record.index);
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
        self.note_departures(watermark.scene_events, tick);
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
            self.apply_refresh(lost, as_of, refresh, &origins);
        }
        self.note_attached_changed();
        Ok(())
    }

    /// Applies a refresh of a missing packet. A refresh of a received packet contains nothing new.
    fn apply_refresh(&mut self, lost: u64, as_of: Tick, refresh: &Refresh, origins: &[Tick]) {
        self.statistics.refreshes += 1;
        if let Some(relayed_packets) = &mut self.relayed_packets {
            relayed_packets.note_packet(lost);
        }
        for (record, origin) in refresh.records.iter().zip(origins.iter().copied()) {
            let keyframe = UpdatePayload::Keyframe(record.keyframe);
            // Without a missed alias assignment, a body's next update would apply to the wrong body.
            let owner = self.owner(record.index, as_of);
            match record.alias {
                Some(alias) => self.aliases.take(alias, record.index, as_of, owner),
                None => self.aliases.release_by(record.index, as_of),
            }
            self.note_relayed(lost, record.index);
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
    fn doubt_earlier(&mut self, index: u32, after: Tick) {
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
    fn take(&mut self, index: u32, tick: Tick, payload: &UpdatePayload) -> Result<(), Unreadable> {
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
    fn apply_record(&mut self, index: u32, origin: Tick, payload: &UpdatePayload) {
        let before = self.tracks.slot(index).map(|slot| *slot.dense());
        if self.tracks.apply(index, origin, payload).is_ok() {
            self.note_attached(index, before.and_then(|before| before.parent()));
            if let Some(before) = before {
                self.keep_earlier(index, before);
            }
            self.note_changed(index);
        }
        self.doubt_earlier(index, self.converged_at);
    }

    /// Notes a body that became attached.
    fn note_attached(&mut self, index: u32, before: Option<BodyId>) {
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
        self.note_changed(index);
    }

    /// Applies all updates of a packet.
    fn apply_all(&mut self, number: u64, tick: Tick, updates: &[Update]) {
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
        let Some(corrected) = self.tracks.correct(batch) else {
            return;
        };
        for lane in 0..corrected.len() {
            let applied = self.tracks.apply_corrected(batch, &corrected, lane, tick);
            if let Some((index, before)) = applied {
                self.note_applied(index, Some(before));
            }
        }
        batch.clear();
    }

    /// The state of the body of an alias assignment at a tick.
    fn owner(&self, index: u32, tick: Tick) -> AliasOwner {
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
        self.note_relayed(number, index);
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

    /// Notes a body of a packet, for an edge.
    fn note_relayed(&mut self, number: u64, index: u32) {
        if let Some(relayed_packets) = &mut self.relayed_packets {
            relayed_packets.note_body(number, index);
        }
    }

    /// Keeps a packet to decode repair symbols with it, and to read it again.
    fn keep(&mut self, number: u64, datagram: &Datagram<'_>) {
        self.fec_decoder.add_packet(number, datagram);
    }

    /// Keeps a repair symbol for recovery.
    fn read_repair_symbol(&mut self, repair_symbol: RepairSymbol) {
        let next = self.gaps.next();
        let last = repair_symbol.last.expand(next);
        // Only packets may move the window that far.
        if !self.placed || last >= next + u64::from(FEC_SPAN) {
            return;
        }
        self.statistics.repair_symbols += 1;
        self.fec_decoder.add(last, repair_symbol);
    }

    /// Reads the packets that repair symbols recover as if they had arrived.
    fn rebuild(&mut self) {
        for (number, source_symbol) in self.fec_decoder.rebuild() {
            if self.read_rebuilt(number, &source_symbol).is_err() {
                self.fec_decoder.drop_repair_symbols(number);
                self.statistics.malformed += 1;
                return;
            }
            self.fec_decoder.add_known(number, &source_symbol);
        }
    }

    fn read_rebuilt(&mut self, number: u64, source_symbol: &[u8]) -> Result<(), Malformed> {
        let datagram =
            packet_of(self.stream, number, source_symbol).ok_or(Malformed::OutOfRange)?;
        let (before, disordered) = (self.statistics.packets, self.statistics.disordered);
        let datagram = Datagram::open(&datagram)?;
        self.read_state(&datagram, packet_in(&datagram)?, Arrival::Rebuilt)?;
        self.statistics.rebuilt += self.statistics.packets - before;
        self.statistics.disordered = disordered;
        Ok(())
    }

    /// Reads packets again that could not be applied without the late one.
    fn read_again_after(&mut self, late: u64, updates: &mut Vec<Update>) {
        let kept = (late + 1..self.gaps.next()).rev().take(FEC_SPAN as usize);
        for number in kept.collect::<Vec<_>>().into_iter().rev() {
            let Some(source_symbol) = self.fec_decoder.source_symbol(number) else {
                continue;
            };
            let Some(datagram) = packet_of(self.stream, number, source_symbol) else {
                continue;
            };
            let Ok(datagram) = Datagram::open(&datagram) else {
                continue;
            };
            let Ok(packet) = packet_in(&datagram) else {
                continue;
            };
            let tick = self.tick_of(packet.tick);
            // It was decoded before, so decoding succeeds again.
            if packet.updates(updates).is_ok() && self.gaps.read_again(number) {
                self.apply_all(number, tick, updates);
            }
        }
    }
}

/// The update packet in a datagram.
fn packet_in<'a>(datagram: &Datagram<'a>) -> Result<UpdatePacket<'a>, Malformed> {
    let ends_tick = datagram.head().kind == PacketKind::UpdatesEnd;
    UpdatePacket::decode(ends_tick, datagram.body())
}

impl Subscriber {
    /// Keeps the bodies of packets from now on, for [`Self::refresh`].
    pub fn keep_relayed_packets(&mut self) {
        self.relayed_packets.get_or_insert_default();
    }

    /// True if the tracks are those of the publisher after all packets of a tick: nothing is missing, and no packet of a
    /// later tick has come.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.is_converged() && self.newest == self.watermark_tick
    }

    /// The largest packet of the stream.
    #[must_use]
    pub const fn largest_packet(&self) -> LargestPacket {
        self.largest_packet
    }

    /// The number after that of the newest packet.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.gaps.next()
    }

    /// The number of scene events received, those of the snapshot included.
    #[must_use]
    pub const fn scene_events(&self) -> u64 {
        self.scene_events
    }

    /// The alias of a body; `None` for a body without one.
    #[must_use]
    pub fn alias_of(&self, id: BodyId) -> Option<u32> {
        self.aliases.of(id.index())
    }

    /// Each gravity that a track may refer to, with its first tick.
    pub fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.tracks.gravity_changes()
    }

    /// The tracks of all bodies, in rising order of index.
    pub fn tracks(&self) -> impl Iterator<Item = (BodyId, rhumb_reckoning::Track)> {
        let slots = self.tracks.iter();
        slots.map(|(index, slot)| (slot.id(index), slot.track()))
    }

    /// True if the bodies of a packet are known.
    #[must_use]
    pub fn relays(&self, number: u64) -> bool {
        let relayed_packets = self.relayed_packets.as_ref();
        relayed_packets.is_some_and(|packets| packets.bodies(number).is_some())
    }

    /// The datagrams with the present tracks of a packet's bodies; `None` for a packet whose bodies are not known.
    #[must_use]
    pub fn refresh(&self, number: u64) -> Option<Vec<Bytes>> {
        let bodies = self.relayed_packets.as_ref()?.bodies(number)?;
        let mut writer = RefreshWriter::within(self.largest_packet);
        for index in bodies {
            if let Some(slot) = self.tracks.slot(*index) {
                writer.push(&self.refresh_record(*index, slot));
            }
        }
        let tick = self.newest.value();
        let datagrams = writer.finish(self.stream, number, tick, self.scene_events);
        Some(datagrams.into_iter().map(Bytes::from).collect())
    }

    /// The watermark of the newest tick.
    #[must_use]
    pub fn watermark(&self) -> Bytes {
        let watermark = Watermark {
            next: Low16::of(self.gaps.next()),
            tick: Low16::of(self.watermark_tick.value()),
            scene_events: Low16::of(self.counted_events),
        };
        let unstated = || ErrorScale::covering(f64::INFINITY);
        let error_scale = self.statements.as_ref().map_or(ErrorScale::NONE, |log| {
            log.stated_at(self.watermark_tick).unwrap_or_else(unstated)
        });
        Bytes::from(match error_scale {
            ErrorScale::NONE => watermark.encode(self.stream),
            error_scale => watermark.encode_over_budget(self.stream, error_scale),
        })
    }

    fn refresh_record(&self, index: u32, slot: &Slot) -> RefreshRecord {
        RefreshRecord {
            index,
            alias: self.aliases.of(index),
            age: self.newest.since(slot.origin()).unwrap_or_default(),
            keyframe: Keyframe::of(&slot.track()),
        }
    }
}
