//! L0.51 to L0.53: golden vectors, played to a client on the wire.
//!
//! Of the many messages that must be refused some of each kind and reason are played; decoders are tried with all of them.

use std::collections::BTreeMap;

use rhumb_protocol::message::Frames;
use rhumb_protocol::packet::{LossReport, Low16, StreamId, Watermark};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::wire::bytes::Writer;
use serde_json::Value;

use super::{hand, table};
use crate::conformance::case::{Case, CaseRow};
use crate::conformance::outcome::{CaseResult, ensure};
use crate::conformance::peer::{Setting, datagram};
use crate::conformance::trial::Trial;
use crate::grammar::unhex;
use crate::vectors::golden;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = refused();
    cases.extend(table("L0.52", SKIPPED));
    cases.extend(table("L0.53", DATAGRAMS));
    cases
}

const SKIPPED: &[CaseRow] = &[(
    1,
    "messages that nobody need know are skipped, as the vectors have them",
    "PROTOCOL 3.5-11, 4.1-2",
    skipped,
)];

const DATAGRAMS: &[CaseRow] = &[
    (
        1,
        "each malformed datagram of the vectors is dropped, and nothing of it predicted_motion",
        "PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.2-2, 5.3-4, 5.3-5, 5.4-4, 5.4-5, 5.5-6, 5.5-7, 5.6-3, 5.6-7, 5.6-9, 5.6-16, 5.6-18, 5.8-5, 5.17-3, 6.5-1",
        |trial| ballistic_torque_free(trial, &datagrams("refused")),
    ),
    (
        2,
        "datagrams of another stream, or of the other end's kind, are dropped",
        "PROTOCOL 5.8-1, 5.8-4, 6.5-3",
        strangers,
    ),
    (
        3,
        "datagrams of an unknown kind are dropped",
        "PROTOCOL 3.5-7, 3.5-16",
        |trial| {
            let of = |kind: u8| (0..16).map(move |stream| vec![stream << 4 | kind, 0, 1, 2, 3, 4]);
            let unknown: Vec<_> = datagram::NO_KINDS.into_iter().flat_map(of).collect();
            ballistic_torque_free(trial, &unknown)
        },
    ),
    (
        4,
        "datagrams with bits flipped, cut short or with bytes behind do no harm",
        "PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.3-4",
        damaged,
    ),
    (
        5,
        "a stream id of 33 bits is not that of its low 32",
        "PROTOCOL 2.5-4, 5.8-5",
        of_a_stream_too_far,
    ),
];

/// Messages that are malformed, some of each kind and reason.
fn refused() -> Vec<Case> {
    let table = golden("control.json");
    let mut found: BTreeMap<_, Vec<(String, Vec<u8>)>> = BTreeMap::new();
    for line in table["refused server messages"]
        .as_array()
        .into_iter()
        .flatten()
    {
        let (name, bytes) = read(line);
        let refusal = line["refusal"].as_str().unwrap_or_default().to_owned();
        let mut frames = Frames::new();
        frames.push(&bytes);
        let Ok(Some(framed)) = frames.next_frame() else {
            continue;
        };
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
                    let mut host = trial.host()?;
                    hand::let_in(&mut host)?;
                    host.utter(&bytes);
                    host.must_be_closed(CloseCode::MALFORMED)
                })
        })
        .collect()
}

/// Vectors of one kind and one reason that are played.
const OF_EACH: usize = 2;

fn skipped(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    let table = golden("control.json");
    let lines = table["server messages"].as_array().into_iter().flatten();
    for line in lines.filter(|line| line.get("skipped").is_some()) {
        host.utter(&read(line).1);
    }
    hand::must_go_on(
        &mut host,
        hand::NEXT + 1,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )
}

/// A stream goes on as if nothing had come between.
fn ballistic_torque_free(trial: &mut Trial<'_>, datagrams: &[Vec<u8>]) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 12))?;
    feed.enter()?;
    let stream = feed.mirror()?.stream().stream();
    for (place, datagram) in datagrams.iter().enumerate() {
        let datagram = datagram::of_stream(datagram, stream);
        if datagram.len() <= 1150 {
            feed.host.throw(&datagram)?;
        }
        if place % 10 == 0 {
            feed.step(1)?;
        }
    }
    feed.step(10)?;
    feed.must_follow()
}

/// A watermark for a tick in the name of a stream that is 2³² more than the one that is followed.
fn of_a_stream_too_far(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
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
    host.throw(&far.into_bytes())?;
    hand::must_go_on(
        &mut host,
        hand::NEXT + 1,
        hand::TICK + 2,
        hand::SCENE_EVENTS,
    )?;
    let reported = host.lines_written()?;
    let predicted_motion = reported
        .iter()
        .any(|reported| reported["tick"] == hand::TICK + 1);
    ensure(!predicted_motion, "nothing of it is predicted_motion")
}

fn strangers(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 12))?;
    feed.enter()?;
    let other = StreamId(feed.mirror()?.stream().stream().0 ^ 0x55);
    for sent in datagrams("accepted") {
        feed.host.throw(&datagram::of_stream(&sent, other))?;
    }
    let own = feed.mirror()?.stream().stream();
    // Echoes are what listeners say.
    let loss_report = LossReport {
        next: Low16(1),
        gone: Low16(0),
        repair_symbols: 0,
        lost: Vec::new(),
    };
    feed.host.throw(&loss_report.encode(own))?;
    feed.step(20)?;
    feed.must_follow()
}

/// Before each datagram some that are none any more.
fn damaged(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 30))?;
    let mut dice = trial.dice();
    feed.sift(move |bytes| {
        let mut sent = Vec::new();
        for _ in 0..6 {
            let mut flipped = bytes.clone();
            let bit = dice.below(8 * bytes.len());
            flipped[bit / 8] ^= 1 << (bit % 8);
            sent.push(flipped);
        }
        sent.push(bytes[..dice.below(bytes.len())].to_vec());
        sent.push([&bytes[..], &[0]].concat());
        // Of some it cannot be seen that they are not what was sent: those are QUIC's to keep away.
        sent.retain(|bytes| datagram::read(bytes).is_err());
        sent.push(bytes);
        sent
    });
    feed.enter()?;
    feed.step(60)?;
    feed.must_follow()
}

fn datagrams(section: &str) -> Vec<Vec<u8>> {
    let table = golden("packets.json");
    let lines = table[section].as_array().into_iter().flatten();
    lines
        .map(|line| read(line).1)
        .filter(|bytes| !bytes.is_empty())
        .collect()
}

fn read(line: &Value) -> (String, Vec<u8>) {
    let text = |name: &str| line[name].as_str().unwrap_or_default();
    (text("name").to_owned(), unhex(text("bytes")))
}
