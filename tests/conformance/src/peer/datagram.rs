//! Reads datagrams as far as a case needs to drop or modify them.
//!
//! The head gives the packet kind and the stream (PROTOCOL 5.8); the body is decoded only to check that it is
//! well-formed.

use rhumb_protocol::packet::{
    Checksums, Datagram, FullPacket, Head, LossReport, Low16, PacketKind, Refresh, RepairSymbol,
    StreamId, UpdatePacket, Watermark,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};

use crate::outcome::{Stop, ensure};

/// Kind values that the protocol does not assign.
pub(crate) const NO_KINDS: [u8; 4] = [10, 13, 14, 15];

/// The packet kind of a datagram, if it is a packet.
pub(crate) fn kind(datagram: &[u8]) -> Option<PacketKind> {
    head(datagram).map(|head| head.kind)
}

/// The head of a datagram, if it is a packet.
pub(crate) fn head(datagram: &[u8]) -> Option<Head> {
    Head::decode(&mut Reader::new(datagram)).ok()
}

/// True if a datagram is a packet with a number.
pub(crate) fn is_packet(datagram: &[u8]) -> bool {
    let packets = [
        PacketKind::Updates,
        PacketKind::UpdatesEnd,
        PacketKind::Full,
        PacketKind::FullEnd,
        PacketKind::UpdatesOverBudget,
    ];
    kind(datagram).is_some_and(|kind| packets.contains(&kind))
}

/// The low bits of a packet's tick.
pub(crate) fn tick_of(packet: &[u8]) -> Option<u16> {
    let mut reader = Reader::new(packet);
    let head = Head::decode(&mut reader).ok()?;
    if head.kind == PacketKind::UpdatesOverBudget {
        reader.u8().ok()?;
    }
    reader.u16().ok()?;
    reader.u16().ok()
}

/// The same datagram under another stream id. A datagram whose stream cannot be read stays unchanged.
pub(crate) fn of_stream(datagram: &[u8], stream: StreamId) -> Vec<u8> {
    let mut reader = Reader::new(datagram);
    let is_read = match reader.u8().map(|first| first >> 4) {
        Ok(15) => reader
            .varint32()
            .is_ok_and(|more| more.checked_add(15).is_some()),
        other => other.is_ok(),
    };
    if !is_read {
        return datagram.to_vec();
    }
    let kind = PacketKind::Updates;
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    let mut bytes = to.into_bytes();
    bytes[0] |= datagram[0] & 0x0f;
    bytes.extend_from_slice(reader.rest());
    bytes
}

/// Checks that a datagram is a well-formed packet of some stream.
///
/// # Errors
///
/// The way in which it is malformed.
pub(crate) fn read(datagram: &[u8]) -> Result<(), Malformed> {
    let datagram = Datagram::open(datagram)?;
    let from = datagram.body();
    let mut updates = Vec::new();
    match datagram.head().kind {
        PacketKind::Updates | PacketKind::UpdatesEnd => {
            UpdatePacket::decode(true, from)?.updates(&mut updates)
        }
        PacketKind::UpdatesOverBudget => {
            UpdatePacket::decode_over_budget(from)?.updates(&mut updates)
        }
        PacketKind::Watermark => Watermark::decode(from).map(drop),
        PacketKind::WatermarkOverBudget => Watermark::decode_over_budget(from).map(drop),
        PacketKind::Refresh => Refresh::decode(from).map(drop),
        PacketKind::Full | PacketKind::FullEnd => FullPacket::decode(true, from).map(drop),
        PacketKind::LossReport => LossReport::decode(from).map(drop),
        PacketKind::Checksums => Checksums::decode(from).map(drop),
        PacketKind::RepairSymbol => RepairSymbol::decode(from).map(drop),
    }
}

/// Decodes the body of a datagram.
///
/// # Errors
///
/// [`Stop::Fail`] when it is malformed.
pub(crate) fn body<'a, T>(
    bytes: &'a [u8],
    decode: impl FnOnce(Reader<'a>) -> Result<T, Malformed>,
) -> Result<T, Stop> {
    let mut reader = Reader::new(bytes);
    let read = Head::decode(&mut reader).and_then(|_| decode(reader));
    read.map_err(|why| Stop::Fail(format!("a datagram is malformed: {why:?}")))
}

/// The state packet, if the datagram is one; its updates are decoded too.
///
/// # Errors
///
/// [`Stop::Fail`] when it is malformed, or when its updates are out of order.
pub(crate) fn state_packet(
    kind: PacketKind,
    bytes: &[u8],
) -> Result<Option<UpdatePacket<'_>>, Stop> {
    if !matches!(kind, PacketKind::Updates | PacketKind::UpdatesEnd) {
        return Ok(None);
    }
    let packet = body(bytes, |reader| {
        UpdatePacket::decode(kind == PacketKind::UpdatesEnd, reader)
    })?;
    let again = body(bytes, |reader| {
        UpdatePacket::decode(kind == PacketKind::UpdatesEnd, reader)
    })?;
    let mut updates = Vec::new();
    again
        .updates(&mut updates)
        .map_err(|why| Stop::Fail(format!("updates are malformed: {why:?}")))?;
    let rise = updates.windows(2).all(|pair| pair[0].alias < pair[1].alias);
    ensure(rise, "updates come in rising order of alias")?;
    Ok(Some(packet))
}

/// The tick that a datagram completes, if any.
///
/// # Errors
///
/// [`Stop::Fail`] when it is malformed.
pub(crate) fn completed_tick(kind: PacketKind, bytes: &[u8]) -> Result<Option<Low16>, Stop> {
    Ok(match kind {
        PacketKind::UpdatesEnd => state_packet(kind, bytes)?.map(|packet| packet.tick),
        PacketKind::Watermark => Some(body(bytes, Watermark::decode)?.tick),
        PacketKind::Checksums => Some(body(bytes, Checksums::decode)?.tick),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_stream_id_of_a_datagram_is_replaced() {
        for (sent, stream, named) in [
            ("58ffff3f01", 3, "38ffff3f01"),
            ("f80201", 3, "3801"),
            ("f88080010102", 20, "f8050102"),
            ("1a01", 4, "4a01"),
            ("f8ff", 4, "f8ff"),
            ("f8f1ffffff0f01", 4, "f8f1ffffff0f01"),
            ("", 4, ""),
        ] {
            let bytes = crate::grammar::unhex(sent);
            assert_eq!(
                crate::grammar::hex(&of_stream(&bytes, StreamId(stream))),
                named
            );
        }
    }
}
