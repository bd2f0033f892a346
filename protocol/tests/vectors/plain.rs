//! Datagrams without a range coder: full packets and checksums.
//!
//! Cases at the limits of their formats, and refused variants.

use std::fmt::Write;

use rhumb_protocol::packet::{
    Checksums, FullPacket, FullRecord, Head, Low16, PacketKind, StreamId,
};
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::BodyState;

use crate::case::NamedPacket;

const STREAM: StreamId = StreamId(5);

fn motion(numbers: [f32; 3]) -> BodyState {
    let motion = BodyState::new(
        numbers,
        [0.5, -0.5, 0.5, 0.5],
        [0.0, -9.5, 0.0],
        [0.0, 0.0, -0.0],
    );
    motion.expect("finite, and of unit length")
}

fn full(records: usize, ends_tick: bool) -> Vec<u8> {
    let record = |place| FullRecord {
        index: (1 << 20) - 1 - place as u32,
        motion: motion([place as f32, f32::MAX, -1e-40]),
    };
    let packet = FullPacket {
        number: Low16(4_464),
        tick: Low16(300),
        scene_events: Low16(12),
        ends_tick,
        records: (0..records).map(record).collect(),
    };
    packet.encode(STREAM)
}

fn checksums(sum: u64) -> Vec<u8> {
    let checksums = Checksums {
        next: Low16(4_464),
        tick: Low16(300),
        scene_events: Low16(12),
        sum,
    };
    checksums.encode(STREAM)
}

/// The accepted datagrams.
pub(crate) fn accepted() -> Vec<NamedPacket> {
    let mut cases: Vec<NamedPacket> = Vec::new();
    for records in [0, 1, 2, FullPacket::RECORDS_MAX] {
        for ends_tick in [false, true] {
            let word = if ends_tick { "the last" } else { "more follow" };
            cases.push((
                format!("full, {records} bodies, {word}"),
                full(records, ends_tick),
            ));
        }
    }
    for sum in [0, u64::MAX / 3, u64::MAX] {
        cases.push((format!("a checksums of {sum:x}"), checksums(sum)));
    }
    cases
}

/// The refused datagrams.
pub(crate) fn refused() -> Vec<NamedPacket> {
    let mut cases: Vec<NamedPacket> = Vec::new();
    let one = full(1, true);
    for cut in [8, 11, one.len() - 1] {
        cases.push((format!("full, cut at {cut}"), one[..cut].to_vec()));
    }
    let with = |place: usize, bytes: [u8; 4]| {
        let mut changed = one.clone();
        changed[place..place + 4].copy_from_slice(&bytes);
        changed
    };
    cases.push((
        "full, an index too large".to_owned(),
        with(7, (1_u32 << 20).to_le_bytes()),
    ));
    for field in 0..13 {
        for (word, number) in [("NaN", f32::NAN), ("infinite", f32::NEG_INFINITY)] {
            let bytes = with(11 + 4 * field, number.to_le_bytes());
            cases.push((format!("full, number {field} {word}"), bytes));
        }
    }
    cases.push((
        "full, a rotation too long".to_owned(),
        with(23, 2.0_f32.to_le_bytes()),
    ));
    let sums = checksums(u64::MAX / 3);
    for cut in 1..sums.len() {
        cases.push((format!("a checksums, cut at {cut}"), sums[..cut].to_vec()));
    }
    cases.push((
        "a byte behind a checksums".to_owned(),
        [&sums[..], &[0]].concat(),
    ));
    cases
}

/// The JSON fields of such a datagram.
pub(crate) fn meaning(head: Head, reader: Reader<'_>) -> Result<String, Malformed> {
    let mut body = String::new();
    let accepted = match head.kind {
        PacketKind::Checksums => {
            let checksums = Checksums::decode(reader)?;
            write!(
                body,
                "\"kind\": 7, \"next\": {}, \"tick\": {}, \"events\": {}, \"checksum\": \"{:016x}\"",
                checksums.next.0, checksums.tick.0, checksums.scene_events.0, checksums.sum
            )
        }
        _ => {
            let ends_tick = head.kind == PacketKind::FullEnd;
            let packet = FullPacket::decode(ends_tick, reader)?;
            let records: Vec<_> = packet.records.iter().map(record).collect();
            write!(
                body,
                "\"kind\": {}, \"number\": {}, \"tick\": {}, \"events\": {}, \"records\": [{}]",
                4 + u8::from(ends_tick),
                packet.number.0,
                packet.tick.0,
                packet.scene_events.0,
                records.join(", ")
            )
        }
    };
    accepted.expect("writing to a string does not fail");
    Ok(body)
}

fn record(record: &FullRecord) -> String {
    let parts = record
        .motion
        .parts()
        .map(|part| format!("\"{:08x}\"", part.to_bits()));
    format!(
        "{{\"index\": {}, \"motion\": [{}]}}",
        record.index,
        parts.join(", ")
    )
}
