//! What a datagram is, as far as a case must know to lose or to spoil it.
//!
//! PacketKind and stream are told by its head (PROTOCOL 5.8); what it says is read only to see that it says something.

use rhumb_protocol::packet::{
    Checksums, FullPacket, Head, LossReport, PacketKind, Refresh, RepairSymbol, StreamId,
    UpdatePacket, Watermark,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};

/// The kinds that no datagram has.
pub(crate) const NO_KINDS: [u8; 4] = [10, 13, 14, 15];

/// What it is, if it is something.
pub(crate) fn kind(datagram: &[u8]) -> Option<PacketKind> {
    head(datagram).map(|head| head.kind)
}

/// What it begins with, if it is something.
pub(crate) fn head(datagram: &[u8]) -> Option<Head> {
    Head::decode(&mut Reader::new(datagram)).ok()
}

/// Whether it is a packet with a number.
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

/// The same datagram, whatever it is, in the name of another stream; one whose stream cannot be read stays as it is.
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

/// Whether a datagram is one of some stream.
///
/// # Errors
///
/// What is wrong with it.
pub(crate) fn read(datagram: &[u8]) -> Result<(), Malformed> {
    let mut from = Reader::new(datagram);
    let head = Head::decode(&mut from)?;
    let mut updates = Vec::new();
    match head.kind {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_of_another_stream_says_the_same() {
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
