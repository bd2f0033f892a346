//! L0.51 to L0.53: golden vectors of servers and of streams, played on the wire.
//!
//! Of the many messages that must be refused some of each kind and reason are played; decoders are tried with all of them.

use std::collections::BTreeMap;
use std::path::Path;

use rhumb_protocol::message::Frames;
use rhumb_protocol::packet::{
    FullPacket, Head, Kind, Parity, Repair, StatePacket, StreamId, Vouch,
};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use serde_json::Value;

use super::hand;
use crate::conformance::case::Case;
use crate::conformance::outcome::Play;
use crate::conformance::peer::Setting;
use crate::conformance::trial::Trial;
use crate::grammar::unhex;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = refused();
    cases.push(
        Case::client(
            "L0.52.1",
            "messages that nobody need know are skipped, as the vectors have them",
        )
        .cites("PROTOCOL 3.5-11, 4.1-2")
        .play(skipped),
    );
    cases.push(
        Case::client("L0.53.1", "each malformed datagram of the vectors is dropped, and nothing of it believed")
            .cites("PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.2-2, 5.3-4, 5.3-5, 5.4-4, 5.4-5, 5.6-3, 5.6-7, 5.6-9, 5.17-3, 6.5-1")
            .play(|trial| thrown(trial, &datagrams("refused"))),
    );
    cases.push(
        Case::client(
            "L0.53.2",
            "datagrams of another stream, or of the other end's kind, are dropped",
        )
        .cites("PROTOCOL 5.8-1, 5.8-4, 6.5-3")
        .play(strangers),
    );
    cases.push(
        Case::client("L0.53.3", "datagrams of an unknown kind are dropped")
            .cites("PROTOCOL 3.5-7, 3.5-16")
            .play(|trial| {
                let unknown = (10..=255_u8).filter(|kind| !(11..=12).contains(kind));
                let datagrams: Vec<_> = unknown.map(|kind| vec![kind, 0, 1, 2, 3, 4]).collect();
                thrown(trial, &datagrams)
            }),
    );
    cases.push(
        Case::client(
            "L0.53.4",
            "datagrams with bits flipped, cut short or with bytes behind do no harm",
        )
        .cites("PROTOCOL 2.5-1, 2.5-4, 5.1-2, 5.3-4")
        .play(damaged),
    );
    cases
}

/// Messages that are malformed, some of each kind and reason.
fn refused() -> Vec<Case> {
    let table = vectors("control.json");
    let mut found: BTreeMap<(u8, String), Vec<(String, Vec<u8>)>> = BTreeMap::new();
    for line in table["refused of a server"]
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

fn skipped(trial: &mut Trial<'_>) -> Play {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    let table = vectors("control.json");
    let lines = table["server says"].as_array().into_iter().flatten();
    for line in lines.filter(|line| line.get("skipped").is_some()) {
        host.utter(&read(line).1);
    }
    hand::must_go_on(&mut host, hand::NEXT + 1, hand::TICK + 1, hand::NOTICES)
}

/// A stream goes on as if nothing had come between.
fn thrown(trial: &mut Trial<'_>, datagrams: &[Vec<u8>]) -> Play {
    let mut feed = trial.feed(Setting::of("ball-pit", 12))?;
    feed.enter()?;
    let stream = feed.mirror()?.stream().stream();
    for (place, datagram) in datagrams.iter().enumerate() {
        let datagram = of_stream(datagram, stream);
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

/// The same datagram of another stream, if so much of it can be read.
fn of_stream(datagram: &[u8], stream: StreamId) -> Vec<u8> {
    let mut reader = Reader::new(datagram);
    let Ok(head) = Head::decode(&mut reader) else {
        return datagram.to_vec();
    };
    let mut to = Writer::new();
    Head { stream, ..head }.encode(&mut to);
    let mut bytes = to.into_bytes();
    bytes.extend_from_slice(reader.rest());
    bytes
}

fn strangers(trial: &mut Trial<'_>) -> Play {
    let mut feed = trial.feed(Setting::of("ball-pit", 12))?;
    feed.enter()?;
    let other = StreamId(feed.mirror()?.stream().stream().0 ^ 0x55);
    for datagram in datagrams("said") {
        feed.host.throw(&of_stream(&datagram, other))?;
    }
    let own = feed.mirror()?.stream().stream();
    // Echoes and doubts are what listeners say.
    for kind in [6_u8, 8] {
        let mut bytes = vec![kind];
        let mut to = Writer::new();
        own.encode(&mut to);
        bytes.extend(to.into_bytes());
        bytes.extend_from_slice(if kind == 6 {
            &[1, 0, 0, 0, 0, 0]
        } else {
            &[0, 1]
        });
        feed.host.throw(&bytes)?;
    }
    feed.step(20)?;
    feed.must_follow()
}

/// Before each datagram some that are none any more.
fn damaged(trial: &mut Trial<'_>) -> Play {
    let mut feed = trial.feed(Setting::of("ball-pit", 30))?;
    let mut dice = trial.dice();
    feed.sift(move |bytes| {
        let mut said = Vec::new();
        for _ in 0..6 {
            let mut flipped = bytes.clone();
            let bit = dice.below(8 * bytes.len());
            flipped[bit / 8] ^= 1 << (bit % 8);
            said.push(flipped);
        }
        said.push(bytes[..dice.below(bytes.len())].to_vec());
        said.push([&bytes[..], &[0]].concat());
        // Of some it cannot be seen that they are not what was sent: those are QUIC's to keep away.
        said.retain(|bytes| is_malformed(bytes));
        said.push(bytes);
        said
    });
    feed.enter()?;
    feed.step(60)?;
    feed.must_follow()
}

/// Whether no reader takes it for a datagram of any stream.
fn is_malformed(bytes: &[u8]) -> bool {
    let mut from = Reader::new(bytes);
    let Ok(head) = Head::decode(&mut from) else {
        return true;
    };
    let mut updates = Vec::new();
    match head.kind {
        Kind::State | Kind::StateEnd => StatePacket::decode(true, from)
            .and_then(|packet| packet.updates(&mut updates))
            .is_err(),
        Kind::Vouch => Vouch::decode(from).is_err(),
        Kind::Repair => Repair::decode(from).is_err(),
        Kind::Full | Kind::FullEnd => FullPacket::decode(true, from).is_err(),
        Kind::Parity => Parity::decode(from).is_err(),
        _ => false,
    }
}

fn datagrams(section: &str) -> Vec<Vec<u8>> {
    let table = vectors("packets.json");
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

/// A file of the vectors.
pub(super) fn vectors(file: &str) -> Value {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors");
    let text = std::fs::read_to_string(folder.join(file));
    let text = text.expect("the vectors lie beside this package");
    serde_json::from_str(&text).expect("the vectors are JSON")
}
