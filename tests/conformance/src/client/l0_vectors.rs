//! L0.51 to L0.53: golden vectors, sent to a client over a connection.
//!
//! Of the many messages that must be refused, a few of each kind and reason are sent; decoders are tested with all of
//! them.

use std::collections::BTreeMap;

use rhumb_protocol::message::Frames;
use rhumb_protocol::packet::{LossReport, Low16, StreamId, Watermark};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::wire::bytes::Writer;
use serde_json::Value;

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::grammar::unhex;
use crate::outcome::{CaseResult, ensure};
use crate::peer::{Setting, datagram};
use crate::trial::Trial;
use crate::vectors::golden;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = refused();
    cases.extend(table("L0.52", SKIPPED));
    cases.extend(table("L0.53", DATAGRAMS));
    cases
}

const SKIPPED: &[CaseRow] = &[(
    1,
    "unassigned optional messages of the vectors are skipped",
    "PROTOCOL 3.5-3, 4.1-2",
    skipped,
)];

const DATAGRAMS: &[CaseRow] = &[
    (
        1,
        "each malformed datagram of the vectors is dropped without any effect",
        "PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.2-2, 5.3-5, 5.3-4, 5.4-4, 5.4-5, 5.5-3, 5.5-4, 5.6-2, 5.6-8, 5.6-10, 5.6-3, 5.6-17, 5.8-2, 5.17-3, 6.5-1",
        |trial| ballistic_torque_free(trial, &datagrams("refused")),
    ),
    (
        2,
        "datagrams of another stream, or of a kind that only a client sends, are dropped",
        "PROTOCOL 5.8-1, 5.8-8, 6.5-3",
        of_other_streams,
    ),
    (
        3,
        "datagrams of an unknown kind are dropped",
        "PROTOCOL 3.5-16, 3.5-8",
        |trial| {
            let of = |kind: u8| (0..16).map(move |stream| vec![stream << 4 | kind, 0, 1, 2, 3, 4]);
            let unknown: Vec<_> = datagram::NO_KINDS.into_iter().flat_map(of).collect();
            ballistic_torque_free(trial, &unknown)
        },
    ),
    (
        4,
        "datagrams with flipped bits, truncated or with trailing bytes do no harm",
        "PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.3-5",
        damaged,
    ),
    (
        5,
        "a stream id of 33 bits is not truncated to 32",
        "PROTOCOL 2.5-4, 5.8-2",
        with_a_stream_id_of_33_bits,
    ),
];

/// Malformed messages, a few of each kind and reason.
fn refused() -> Vec<Case> {
    let table = golden("control.json");
    let mut found: BTreeMap<_, Vec<(String, Vec<u8>)>> = BTreeMap::new();
    for line in lines_of(&table, "refused server messages") {
        let (name, bytes) = read(line);
        let refusal = line["refusal"].as_str().unwrap_or_default().to_owned();
        let mut frames = Frames::new();
        frames.push(&bytes);
        let Ok(Some(framed)) = frames.next_frame() else {
            continue;
        };
        // A client without cells skips them, malformed or not (3.5-3).
        if framed.kind == OF_CELL {
            continue;
        }
        let alike = found.entry((framed.kind, refusal)).or_default();
        if alike.len() < OF_EACH && alike.iter().all(|(_, other)| *other != bytes) {
            alike.push((name, bytes));
        }
    }
    let found = found.into_values().flatten();
    found
        .map(|(name, bytes)| {
            Case::client("L0.51", &format!("refused: {name}"))
                .keyed(&bytes)
                .cites("PROTOCOL 2.2-3, 2.5-1, 2.5-3, 4.1-4")
                .play(move |trial| {
                    let mut server = trial.raw_server()?;
                    hand::admit(&mut server)?;
                    server.send_bytes(&bytes);
                    server.must_be_closed(CloseCode::MALFORMED)
                })
        })
        .collect()
}

/// Number of vectors that are sent of each kind and reason.
const OF_EACH: usize = 2;
const OF_CELL: u8 = 129;

fn skipped(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    let table = golden("control.json");
    let lines = lines_of(&table, "server messages").iter();
    for line in lines.filter(|line| line.get("skipped").is_some()) {
        server.send_bytes(&read(line).1);
    }
    hand::must_go_on(
        &mut server,
        hand::NEXT + 1,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )
}

/// Requires that a stream continues correctly although these datagrams are inserted.
fn ballistic_torque_free(trial: &mut Trial<'_>, datagrams: &[Vec<u8>]) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 12))?;
    interceptor.enter()?;
    let stream = interceptor.mirror()?.stream().stream();
    for (place, datagram) in datagrams.iter().enumerate() {
        let datagram = datagram::of_stream(datagram, stream);
        if datagram.len() <= 1150 {
            interceptor.raw_server.send_datagram(&datagram)?;
        }
        if place % 10 == 0 {
            interceptor.step(1)?;
        }
    }
    interceptor.step(10)?;
    interceptor.must_follow()
}

/// Sends a watermark for a stream id that is 2³² greater than that of the followed stream.
fn with_a_stream_id_of_33_bits(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    let watermark = Watermark {
        next: Low16::of(hand::NEXT),
        tick: Low16::of(hand::TICK + 1),
        scene_events: Low16::of(hand::SCENE_EVENTS),
    };
    let mut bytes = watermark.encode(StreamId(15));
    let (head, more) = (bytes.remove(0), u64::from(hand::STREAM.0) + (1 << 32) - 15);
    let mut far = Writer::new();
    far.u8(head);
    far.varint(more);
    far.raw(&bytes[1..]);
    server.send_datagram(&far.into_bytes())?;
    hand::must_go_on(
        &mut server,
        hand::NEXT + 1,
        hand::TICK + 2,
        hand::SCENE_EVENTS,
    )?;
    let reported = server.lines_written()?;
    let is_reported = reported
        .iter()
        .any(|reported| reported["tick"] == hand::TICK + 1);
    ensure(!is_reported, "the client must ignore it")
}

fn of_other_streams(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 12))?;
    interceptor.enter()?;
    let other = StreamId(interceptor.mirror()?.stream().stream().0 ^ 0x55);
    for sent in datagrams("accepted") {
        interceptor
            .raw_server
            .send_datagram(&datagram::of_stream(&sent, other))?;
    }
    let own = interceptor.mirror()?.stream().stream();
    // Only subscribers send loss reports.
    let loss_report = LossReport {
        next: Low16(1),
        abandoned: Low16(0),
        repair_symbols: 0,
        lost: Vec::new(),
    };
    interceptor
        .raw_server
        .send_datagram(&loss_report.encode(own))?;
    interceptor.step(20)?;
    interceptor.must_follow()
}

/// Inserts some damaged copies before each datagram.
fn damaged(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 30))?;
    let mut dice = trial.dice();
    interceptor.filter_datagrams(move |bytes| {
        let mut sent = Vec::new();
        for _ in 0..6 {
            let mut flipped = bytes.clone();
            let bit = dice.below(8 * bytes.len());
            flipped[bit / 8] ^= 1 << (bit % 8);
            sent.push(flipped);
        }
        sent.push(bytes[..dice.below(bytes.len())].to_vec());
        sent.push([&bytes[..], &[0]].concat());
        // Some damaged copies are still well-formed; QUIC must prevent those, not the client.
        sent.retain(|bytes| datagram::read(bytes).is_err());
        sent.push(bytes);
        sent
    });
    interceptor.enter()?;
    interceptor.step(60)?;
    interceptor.must_follow()
}

/// A section of a vector file.
fn lines_of<'a>(table: &'a Value, section: &str) -> &'a Vec<Value> {
    table[section]
        .as_array()
        .expect("the vectors have this section")
}

fn datagrams(section: &str) -> Vec<Vec<u8>> {
    let table = golden("packets.json");
    let lines = lines_of(&table, section).iter();
    lines
        .map(|line| read(line).1)
        .filter(|bytes| !bytes.is_empty())
        .collect()
}

fn read(line: &Value) -> (String, Vec<u8>) {
    let text = |name: &str| line[name].as_str().unwrap_or_default();
    (text("name").to_owned(), unhex(text("bytes")))
}
