//! Messages of an edge to its subscribers, from its tracks (PROTOCOL 14).
//!
//! An edge forwards the packets of a stream as they are. Its subscriber has the publisher's tracks, so that it makes
//! snapshots, refreshes and watermarks in the publisher's place. Encodes no updates, and knows no receivers. Invariant:
//! what it says is true of the publisher's stream at the tick that it names, so it speaks only while it is settled.

use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, Tick};

use super::Subscriber;
use crate::packet::{
    ErrorScale, Keyframe, LargestPacket, Low16, RefreshRecord, RefreshWriter, Watermark,
};
use crate::stream::tracks::Slot;

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
