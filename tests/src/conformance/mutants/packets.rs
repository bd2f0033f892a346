//! State packets that say less than they did.

use rhumb_protocol::packet::{Head, Kind, Saying, StatePacket, StateWriter, Update};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;

/// The updates of a packet with its head, if it is one of a reckoned stream.
pub(super) fn updates_of(bytes: &[u8]) -> Option<(Head, StatePacket<'_>, Vec<Update>)> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader).ok()?;
    let ends = match head.kind {
        Kind::State => false,
        Kind::StateEnd => true,
        _ => return None,
    };
    let packet = StatePacket::decode(ends, reader).ok()?;
    let mut updates = Vec::new();
    packet.clone().updates(&mut updates).ok()?;
    Some((head, packet, updates))
}

pub(super) fn written(head: Head, packet: &StatePacket<'_>, updates: &[Update]) -> Option<Vec<u8>> {
    let [number, tick, notices] =
        [packet.number, packet.tick, packet.notices].map(|low| u64::from(low.0));
    let mut writer = StateWriter::new(head.stream, number, tick, notices);
    for update in updates {
        if !writer.push(update) {
            return None;
        }
    }
    Some(writer.finish(packet.ends_tick))
}

/// The same packet without bodies that come to rest.
pub(super) fn without_rests(bytes: &[u8]) -> Option<Vec<u8>> {
    let (head, packet, mut updates) = updates_of(bytes)?;
    updates.retain(|update| !matches!(update.saying, Saying::Settled { .. }));
    written(head, &packet, &updates)
}
