//! Fuzzes the datagram codec with arbitrary bytes and with valid packets.
//!
//! Promises: a decoded packet is encoded as it was, byte for byte, so each value has one encoding. An encoded packet
//! is decoded as it was. The range decoder accepts or refuses any input without a panic.

use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::packet::{
    Checksums, FullPacket, Head, LossReport, Low16, PacketKind, Refresh, RefreshRecord,
    RefreshWriter, RepairSymbol, StreamId, TestEncoder, Update, UpdatePacket, UpdateWriter,
    Watermark,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Ticks;

use super::payloads::{keyframe, updates};
use super::script::Script;

const STREAM: StreamId = StreamId(3);

/// All packet kinds.
pub(super) const KINDS: [PacketKind; 11] = [
    PacketKind::Updates,
    PacketKind::UpdatesEnd,
    PacketKind::Watermark,
    PacketKind::Refresh,
    PacketKind::Full,
    PacketKind::FullEnd,
    PacketKind::LossReport,
    PacketKind::Checksums,
    PacketKind::RepairSymbol,
    PacketKind::UpdatesOverBudget,
    PacketKind::WatermarkOverBudget,
];

/// A datagram that contains only its head so far.
pub(super) fn begun(kind: PacketKind, stream: StreamId) -> Vec<u8> {
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    to.into_bytes()
}

/// State packets: arbitrary bytes, valid packets with a flipped bit, and meaningless numbers.
pub fn state_packets(data: &[u8]) {
    let mut script = Script::new(data);
    let datagram = match script.below(3) {
        0 => script.rest().to_vec(),
        1 => sent(&mut script),
        _ => meaningless_numbers(&mut script),
    };
    let _ = written_again(&datagram);
}

/// Packets of every other kind: arbitrary bytes, and refreshes with a flipped bit.
pub fn side_packets(data: &[u8]) {
    let mut script = Script::new(data);
    let datagram = if script.any() {
        script.rest().to_vec()
    } else {
        let mut datagram = refresh(&mut script);
        turn(&mut script, &mut datagram);
        datagram
    };
    let _ = written_again(&datagram);
}

/// Flips a bit, unless the script has ended.
fn turn(script: &mut Script<'_>, datagram: &mut [u8]) {
    if script.goes_on() {
        let bit = script.below(datagram.len() * 8);
        datagram[bit / 8] ^= 1 << (bit % 8);
    }
}

/// A packet that a publisher may send, after a check that it decodes correctly.
fn sent(script: &mut Script<'_>) -> Vec<u8> {
    let mut writer = UpdateWriter::new(STREAM, script.any(), script.any(), script.any());
    let mut all = updates(script, 12);
    let fits = all.iter().take_while(|update| writer.push(update)).count();
    all.truncate(fits);
    let mut datagram = writer.finish(script.any());
    assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
    assert_eq!(written_again(&datagram), Ok(()), "{all:?}");
    let mut reader = Reader::new(&datagram);
    let head = Head::decode(&mut reader).expect("bytes that were just encoded");
    let mut read = Vec::new();
    UpdatePacket::decode(head.kind == PacketKind::UpdatesEnd, reader)
        .and_then(|packet| packet.updates(&mut read))
        .expect("bytes that were just encoded");
    assert_eq!(read, all, "the decoded updates differ");
    turn(script, &mut datagram);
    datagram
}

/// Numbers in contexts of the range coder that no publisher sends.
fn meaningless_numbers(script: &mut Script<'_>) -> Vec<u8> {
    let mut test_encoder = TestEncoder::default();
    while script.goes_on() {
        test_encoder = match script.below(4) {
            0 => test_encoder.code(script.below(2), script.below(18)),
            1 => {
                let bits = 1 + script.below(31) as u32;
                test_encoder.raw(script.any::<u32>() & ((1 << bits) - 1), bits)
            }
            2 => test_encoder.escape(script.below(4)),
            _ => {
                let small = script.any::<bool>();
                let number = script.any::<u32>();
                test_encoder.number(script.below(8), if small { number & 0xff } else { number })
            }
        };
    }
    let mut datagram = begun(PacketKind::UpdatesEnd, STREAM);
    datagram.extend_from_slice(&[0; 6]);
    datagram.extend(test_encoder.into_bytes());
    datagram
}

/// Refreshes with any tracks.
fn refresh(script: &mut Script<'_>) -> Vec<u8> {
    let mut writer = RefreshWriter::default();
    let mut index = 0;
    let mut records = Vec::new();
    for _ in 0..script.below(8) {
        let record = RefreshRecord {
            index,
            alias: script.any::<bool>().then(|| script.below(300) as u32),
            age: Ticks::new(script.any::<u32>() % (1 << 30)),
            keyframe: keyframe(script),
        };
        writer.push(&record);
        records.push(record);
        index += 1 + script.below(300) as u32;
    }
    let (lost, tick) = (script.any::<u16>(), script.any::<u16>());
    let parts = writer.finish(STREAM, lost.into(), tick.into(), 0);
    let mut read = Vec::new();
    for part in &parts {
        assert_eq!(written_again(part), Ok(()));
        let mut reader = Reader::new(part);
        Head::decode(&mut reader).expect("bytes that were just encoded");
        read.extend(
            Refresh::decode(reader)
                .expect("bytes that were just encoded")
                .records,
        );
    }
    assert_eq!(read, records, "the decoded records differ");
    parts.into_iter().next().expect("a refresh has a part")
}

/// Decodes a datagram and encodes it again.
///
/// # Panics
///
/// When the bytes differ.
pub(super) fn written_again(datagram: &[u8]) -> Result<(), Malformed> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader)?;
    let stream = head.stream;
    let again = match head.kind {
        PacketKind::Updates | PacketKind::UpdatesEnd | PacketKind::UpdatesOverBudget => {
            state_again(head, reader)?
        }
        PacketKind::Watermark => Some(Watermark::decode(reader)?.encode(stream)),
        PacketKind::WatermarkOverBudget => {
            let (watermark, error_scale) = Watermark::decode_over_budget(reader)?;
            Some(watermark.encode_over_budget(stream, error_scale))
        }
        PacketKind::Refresh => refresh_again(head, reader, datagram)?,
        PacketKind::Full | PacketKind::FullEnd => {
            let packet = FullPacket::decode(head.kind == PacketKind::FullEnd, reader)?;
            let fits = packet.records.len() <= FullPacket::RECORDS_MAX;
            fits.then(|| packet.encode(stream))
        }
        PacketKind::LossReport => Some(LossReport::decode(reader)?.encode(stream)),
        PacketKind::Checksums => Some(Checksums::decode(reader)?.encode(stream)),
        PacketKind::RepairSymbol => Some(RepairSymbol::decode(reader)?.encode(stream)),
    };
    if let Some(again) = again {
        assert_eq!(again, datagram, "each value has one encoding");
    }
    Ok(())
}

/// `None` where the encoder would have started another packet.
fn state_again(head: Head, reader: Reader<'_>) -> Result<Option<Vec<u8>>, Malformed> {
    let over_budget = head.kind == PacketKind::UpdatesOverBudget;
    let packet = if over_budget {
        UpdatePacket::decode_over_budget(reader)?
    } else {
        UpdatePacket::decode(head.kind == PacketKind::UpdatesEnd, reader)?
    };
    let number = |low: Low16| u64::from(low.0);
    let (ends_tick, error_scale) = (packet.ends_tick, packet.error_scale);
    let mut writer = UpdateWriter::new(
        head.stream,
        number(packet.number),
        number(packet.tick),
        number(packet.scene_events),
    );
    let mut all: Vec<Update> = Vec::new();
    packet.updates(&mut all)?;
    if !all.iter().all(|update| writer.push(update)) {
        return Ok(None);
    }
    Ok(Some(if over_budget {
        writer.finish_over_budget(error_scale)
    } else {
        writer.finish(ends_tick)
    }))
}

/// An encoder produces all parts of a refresh; the position of the given part among them is unknown.
fn refresh_again(
    head: Head,
    reader: Reader<'_>,
    datagram: &[u8],
) -> Result<Option<Vec<u8>>, Malformed> {
    let behind_head = datagram.len() - reader.rest().len();
    let refresh = Refresh::decode(reader)?;
    let mut writer = RefreshWriter::default();
    for record in &refresh.records {
        writer.push(record);
    }
    let low = |low: Low16| u64::from(low.0);
    let (lost, tick, scene_events) = (
        low(refresh.lost),
        low(refresh.tick),
        low(refresh.scene_events),
    );
    let mut parts = writer.finish(head.stream, lost, tick, scene_events);
    if parts.len() != 1 {
        return Ok(None);
    }
    let place = behind_head + 6;
    parts[0][place..place + 2].copy_from_slice(&[refresh.part, refresh.parts]);
    Ok(parts.pop())
}
