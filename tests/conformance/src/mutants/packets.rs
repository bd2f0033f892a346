//! Removes updates from state packets.

use rhumb_protocol::packet::{Head, PacketKind, Update, UpdatePacket, UpdatePayload, UpdateWriter};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;

/// Head and updates of a packet, if it belongs to a reckoned stream.
pub(super) fn updates_of(bytes: &[u8]) -> Option<(Head, UpdatePacket<'_>, Vec<Update>)> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader).ok()?;
    let ends = match head.kind {
        PacketKind::Updates => false,
        PacketKind::UpdatesEnd => true,
        _ => return None,
    };
    let packet = UpdatePacket::decode(ends, reader).ok()?;
    let mut updates = Vec::new();
    packet.clone().updates(&mut updates).ok()?;
    Some((head, packet, updates))
}

pub(super) fn written(
    head: Head,
    packet: &UpdatePacket<'_>,
    updates: &[Update],
) -> Option<Vec<u8>> {
    let [number, tick, scene_events] =
        [packet.number, packet.tick, packet.scene_events].map(|low| u64::from(low.0));
    let mut writer = UpdateWriter::new(head.stream, number, tick, scene_events);
    for update in updates {
        if !writer.push(update) {
            return None;
        }
    }
    Some(writer.finish(packet.ends_tick))
}

/// The same packet without rest updates.
pub(super) fn without_rests(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, packet, mut updates) = updates_of(bytes)?;
    updates.retain(|update| !matches!(update.payload, UpdatePayload::Resting { .. }));
    written(head, &packet, &updates)
}
