//! Datagrams without a coder: full packets, digests, doubts.
//!
//! Their forms at their limits, and what is refused of each.

use std::fmt::Write;

use rhumb_protocol::packet::{
    Digest, Doubt, FullPacket, FullRecord, Head, Kind, Low16, Ranges, StreamId,
};
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Verbatim;

use crate::document::Case;

const STREAM: StreamId = StreamId(5);

fn motion(numbers: [f32; 3]) -> Verbatim {
    let motion = Verbatim::new(
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
        notices: Low16(12),
        ends_tick,
        records: (0..records).map(record).collect(),
    };
    packet.encode(STREAM)
}

fn digest(sums: usize, ranges: Ranges) -> Vec<u8> {
    let digest = Digest {
        next: Low16(4_464),
        tick: Low16(300),
        notices: Low16(12),
        ranges,
        sums: (0..sums as u64)
            .map(|sum| sum.wrapping_mul(u64::MAX / 3))
            .collect(),
    };
    digest.encode(STREAM)
}

const LAST: Ranges = Ranges {
    first: (1 << 20) - 1,
    stride: 1,
};

/// What is said.
pub(crate) fn said() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
    for records in [0, 1, 2, FullPacket::RECORDS_MAX] {
        for ends_tick in [false, true] {
            let word = if ends_tick { "the last" } else { "more follow" };
            cases.push((
                format!("full, {records} bodies, {word}"),
                full(records, ends_tick),
            ));
        }
    }
    for sums in [0, 1, 2, 128] {
        cases.push((
            format!("a digest of {sums} sums"),
            digest(sums, Ranges::ALL),
        ));
    }
    cases.push(("a digest of the last body".to_owned(), digest(1, LAST)));
    for (word, range) in [("all", Ranges::ALL), ("the last body", LAST)] {
        cases.push((format!("a doubt of {word}"), Doubt { range }.encode(STREAM)));
    }
    cases
}

/// What is refused.
pub(crate) fn refused() -> Vec<Case> {
    let mut cases: Vec<Case> = Vec::new();
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
    let sums = digest(2, Ranges::ALL);
    for cut in 1..sums.len() {
        cases.push((format!("a digest, cut at {cut}"), sums[..cut].to_vec()));
    }
    cases.push((
        "a byte behind a digest".to_owned(),
        [&sums[..], &[0]].concat(),
    ));
    let head = [0x57, 0, 0, 0, 0, 0, 0];
    for (word, rest) in [
        (
            "a digest from an index too large",
            &[0x80, 0x80, 0x40, 1, 0][..],
        ),
        ("a digest of a stride of nothing", &[0, 0, 0]),
        ("a digest of too long a stride", &[0, 0x81, 0x80, 0x40, 0]),
        ("a digest of 129 sums", &[0, 1, 0x81, 1]),
    ] {
        cases.push((word.to_owned(), [&head[..], rest].concat()));
    }
    for (word, rest) in [
        ("a doubt that ends too soon", &[0][..]),
        ("a doubt of nothing", &[0, 0]),
        ("a doubt from an index too large", &[0x80, 0x80, 0x40, 1]),
        ("a doubt of too long a stride", &[0, 0x81, 0x80, 0x40]),
        ("a byte behind a doubt", &[0, 1, 0]),
    ] {
        cases.push((word.to_owned(), [&[0x58][..], rest].concat()));
    }
    cases
}

/// What such a datagram says.
pub(crate) fn meaning(head: Head, reader: Reader<'_>) -> Result<String, Malformed> {
    let mut body = String::new();
    let said = match head.kind {
        Kind::Digest => {
            let digest = Digest::decode(reader)?;
            let sums: Vec<_> = digest
                .sums
                .iter()
                .map(|sum| format!("\"{sum:016x}\""))
                .collect();
            let Ranges { first, stride } = digest.ranges;
            write!(
                body,
                "\"kind\": 7, \"next\": {}, \"tick\": {}, \"notices\": {}, \"first\": {first}, \"stride\": {stride}, \"sums\": [{}]",
                digest.next.0,
                digest.tick.0,
                digest.notices.0,
                sums.join(", ")
            )
        }
        Kind::Doubt => {
            let Ranges { first, stride } = Doubt::decode(reader)?.range;
            write!(
                body,
                "\"kind\": 8, \"first\": {first}, \"stride\": {stride}"
            )
        }
        _ => {
            let ends_tick = head.kind == Kind::FullEnd;
            let packet = FullPacket::decode(ends_tick, reader)?;
            let records: Vec<_> = packet.records.iter().map(record).collect();
            write!(
                body,
                "\"kind\": {}, \"number\": {}, \"tick\": {}, \"notices\": {}, \"records\": [{}]",
                4 + u8::from(ends_tick),
                packet.number.0,
                packet.tick.0,
                packet.notices.0,
                records.join(", ")
            )
        }
    };
    said.expect("a string takes text");
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
