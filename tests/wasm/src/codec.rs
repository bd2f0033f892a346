//! The codec as plain functions: whether bytes are a message or a packet.
//!
//! The caller writes the bytes into a buffer of this module. A decoded message must encode to the same bytes again.

use std::cell::RefCell;

use rhumb_protocol::message::{ClientMessage, Framed, Frames, ServerMessage};
use rhumb_protocol::packet::{
    Checksums, Datagram, FullPacket, LossReport, PacketKind, Refresh, RepairSymbol, UpdatePacket,
    Watermark,
};
use rhumb_protocol::wire::Malformed;

thread_local! {
    static BYTES: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// The side of a message that a client sent.
const CLIENT: u32 = 0;

/// The bytes are malformed.
const REFUSED: u32 = 0;
/// They have a meaning, and encode as they were.
const ACCEPTED: u32 = 1;
/// They are an unknown optional message.
const SKIPPED: u32 = 2;
/// They are a command that a server answers by an error.
const ANSWERED: u32 = 3;
/// They have a meaning, but encode otherwise: a fault.
const CHANGED: u32 = 4;

/// Makes room for so many bytes, and returns their place.
#[unsafe(no_mangle)]
pub extern "C" fn buffer(bytes: u32) -> *const u8 {
    BYTES.with_borrow_mut(|buffer| {
        buffer.clear();
        buffer.resize(bytes as usize, 0);
        buffer.as_ptr()
    })
}

/// Decodes the buffer as one frame of a client (0) or a server (1).
#[unsafe(no_mangle)]
pub extern "C" fn message(side: u32) -> u32 {
    BYTES.with_borrow(|bytes| {
        let mut frames = Frames::new();
        frames.push(bytes);
        match frames.next_frame() {
            Ok(Some(framed)) => decoded(side, &framed, bytes),
            Ok(None) | Err(_) => REFUSED,
        }
    })
}

fn decoded(side: u32, framed: &Framed, bytes: &[u8]) -> u32 {
    let mut written = Vec::new();
    let known =
        match side {
            0 => ClientMessage::decode(framed)
                .map(|message| message.map(|one| one.encode(&mut written))),
            _ => ServerMessage::decode(framed)
                .map(|message| message.map(|one| one.encode(&mut written))),
        };
    match known {
        Ok(Some(())) if written == bytes => ACCEPTED,
        Ok(Some(())) => CHANGED,
        Ok(None) => SKIPPED,
        Err(Malformed::UnknownCommand | Malformed::Motion(_)) if side == CLIENT => ANSWERED,
        Err(_) => REFUSED,
    }
}

/// Decodes the buffer as one datagram.
#[unsafe(no_mangle)]
pub extern "C" fn packet() -> u32 {
    BYTES.with_borrow(|bytes| match opened(bytes) {
        Ok(()) => ACCEPTED,
        Err(_) => REFUSED,
    })
}

fn opened(bytes: &[u8]) -> Result<(), Malformed> {
    let datagram = Datagram::open(bytes)?;
    let reader = datagram.body();
    let updates = |packet: UpdatePacket<'_>| packet.updates(&mut Vec::new());
    match datagram.head().kind {
        PacketKind::Updates => updates(UpdatePacket::decode(false, reader)?),
        PacketKind::UpdatesEnd => updates(UpdatePacket::decode(true, reader)?),
        PacketKind::UpdatesOverBudget => updates(UpdatePacket::decode_over_budget(reader)?),
        PacketKind::Watermark => Watermark::decode(reader).map(drop),
        PacketKind::WatermarkOverBudget => Watermark::decode_over_budget(reader).map(drop),
        PacketKind::Refresh => Refresh::decode(reader).map(drop),
        PacketKind::LossReport => LossReport::decode(reader).map(drop),
        PacketKind::RepairSymbol => RepairSymbol::decode(reader).map(drop),
        PacketKind::Checksums => Checksums::decode(reader).map(drop),
        PacketKind::Full => FullPacket::decode(false, reader).map(drop),
        PacketKind::FullEnd => FullPacket::decode(true, reader).map(drop),
    }
}
