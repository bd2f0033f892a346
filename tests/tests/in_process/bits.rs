//! Every bit of the golden vectors flipped: no panic, no invalid state.
//!
//! Each datagram of a stream is flipped at the time of its receipt: a copy of the subscriber with all earlier data
//! receives it. The resulting predictions are checked for now and for one second later. Of the datagrams of a stream every fourth
//! is flipped, with `RHUMB_TEST_THOROUGH` each one.

use bytes::Bytes;
use rhumb_conformance::grammar::unhex;
use rhumb_conformance::vectors::{Decoded, Sender, deliver, golden, greeted, known};
use rhumb_protocol::message::Frames;
use rhumb_protocol::packet::{
    Checksums, Datagram, FullPacket, LossReport, PacketKind, Refresh, RepairSymbol, UpdatePacket,
    Watermark,
};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::Subscriber;
use rhumb_protocol::wire::Malformed;
use rhumb_protocol::{Endpoint, Instant, Peer};
use rhumb_reckoning::{Anchor, BodyId, Motion, Ticks};
use serde_json::Value;

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn bytes_of(case: &Value) -> Vec<u8> {
    unhex(case["bytes"].as_str().expect("digits"))
}

/// All variants of the bytes that differ in one bit.
fn flips(bytes: &[u8]) -> impl Iterator<Item = Vec<u8>> {
    (0..8 * bytes.len()).map(|bit| {
        let mut flipped = bytes.to_vec();
        flipped[bit / 8] ^= 1 << (bit % 8);
        flipped
    })
}

/// Decodes a datagram as its receiver would.
pub(crate) fn read(bytes: &[u8]) -> Result<(), Malformed> {
    let datagram = Datagram::open(bytes)?;
    let reader = datagram.body();
    match datagram.head().kind {
        PacketKind::Updates | PacketKind::UpdatesEnd => {
            let packet = UpdatePacket::decode(true, reader)?;
            packet.updates(&mut Vec::new())
        }
        PacketKind::UpdatesOverBudget => {
            let packet = UpdatePacket::decode_over_budget(reader)?;
            packet.updates(&mut Vec::new())
        }
        PacketKind::Watermark => Watermark::decode(reader).map(drop),
        PacketKind::WatermarkOverBudget => Watermark::decode_over_budget(reader).map(drop),
        PacketKind::Refresh => Refresh::decode(reader).map(drop),
        PacketKind::Full | PacketKind::FullEnd => FullPacket::decode(true, reader).map(drop),
        PacketKind::LossReport => LossReport::decode(reader).map(drop),
        PacketKind::Checksums => Checksums::decode(reader).map(drop),
        PacketKind::RepairSymbol => RepairSymbol::decode(reader).map(drop),
    }
}

#[test]
fn a_flipped_bit_of_a_datagram_never_panics() {
    let packets = golden("packets.json");
    let (mut refused, mut read_otherwise) = (0_u32, 0_u32);
    for case in list(&packets["accepted"]) {
        for flipped in flips(&bytes_of(case)) {
            match read(&flipped) {
                Ok(()) => read_otherwise += 1,
                Err(_) => refused += 1,
            }
        }
    }
    assert!(refused > 10_000, "{refused}");
    assert!(read_otherwise > 10_000, "{read_otherwise}");
}

#[test]
fn a_flipped_bit_of_a_message_never_panics() {
    let control = golden("control.json");
    let mut read_otherwise = 0_u32;
    for (side, section) in [
        (Sender::Client, "client messages"),
        (Sender::Server, "server messages"),
    ] {
        for case in list(&control[section]) {
            for flipped in flips(&bytes_of(case)) {
                let mut frames = Frames::new();
                frames.push(&flipped);
                while let Ok(Some(framed)) = frames.next_frame() {
                    if !matches!(side.outcome(framed.kind, &framed.body), Decoded::Refused(_)) {
                        read_otherwise += 1;
                    }
                }
            }
        }
    }
    assert!(read_otherwise > 10_000, "{read_otherwise}");
}

/// Checks that a motion is finite, and that its rotation is of unit length.
fn assert_is_motion(motion: &Motion, what: &str) {
    let (pose, twist) = (motion.pose(), motion.twist());
    assert!(pose.position.is_finite(), "{what}: {pose:?}");
    assert!(
        (pose.rotation.length() - 1.0).abs() < 1e-9,
        "{what}: {pose:?}"
    );
    let finite = twist.linear.is_finite() && twist.angular.is_finite();
    assert!(finite, "{what}: {twist:?}");
}

/// Checks that all predictions for these bodies that a datagram changed are within the limits of the wire format.
fn assert_within_limits(before: &Subscriber, stream: &Subscriber, bodies: &[BodyId], what: &str) {
    let is_later = before.watermark_tick() != stream.watermark_tick();
    for id in bodies {
        let Some(track) = stream.track(*id) else {
            continue;
        };
        if !is_later && before.track(*id) == Some(track) {
            continue;
        }
        if let Anchor::Quantised(quantised) = &track.anchor {
            assert!(quantised.is_within_limits(), "{what}: {id}");
        }
        for later in [0, 60] {
            let tick = stream.watermark_tick() + Ticks::new(later);
            let predicted_motion = stream
                .predicted_motion(*id, tick)
                .expect("a body with a track has a prediction");
            assert_is_motion(&predicted_motion, what);
        }
    }
}

fn bodies(replica: &Replica) -> Vec<BodyId> {
    replica.bodies().map(|desc| desc.id).collect()
}

/// Delivers each flip of a datagram to a copy of the session's replica; returns how many changed a track.
fn flip_for(session: &ClientSession, datagram: &[u8], what: &str) -> u32 {
    let Some(replica) = session.replica() else {
        return 0;
    };
    let (stream, bodies) = (replica.stream(), bodies(replica));
    let unchanged = stream.state_checksum();
    let mut changed = 0;
    for flipped in flips(datagram) {
        let is_of_stream = Datagram::open(&flipped)
            .is_ok_and(|datagram| datagram.head().stream == stream.stream());
        if !is_of_stream || read(&flipped).is_err() {
            continue;
        }
        let mut copy = stream.clone();
        copy.handle_datagram(&flipped);
        if copy.state_checksum() != unchanged {
            changed += 1;
            assert_within_limits(stream, &copy, &bodies, what);
        }
    }
    changed
}

#[test]
fn a_flipped_bit_of_a_stream_never_yields_a_pose_outside_the_limits() {
    let every = match std::env::var_os("RHUMB_TEST_THOROUGH") {
        Some(_) => 1,
        None => 4,
    };
    let mut changed = 0;
    for stream in list(&golden("streams.json")["streams"]) {
        let mut session = greeted();
        for (place, event) in list(&stream["events"]).iter().enumerate() {
            if event[0] == "datagram" && place % every == 0 {
                let datagram = unhex(event[1].as_str().expect("digits"));
                let what = format!("event {place} of {}", stream["name"]);
                changed += flip_for(&session, &datagram, &what);
            }
            deliver(&mut session, event);
        }
    }
    assert!(
        changed > 10_000 / every as u32,
        "only {changed} flips changed a prediction"
    );
}

#[test]
fn a_datagram_made_malformed_by_a_flip_changes_nothing() {
    for stream in list(&golden("streams.json")["streams"]) {
        let mut session = greeted();
        for event in list(&stream["events"]) {
            if event[0] == "datagram" {
                let datagram = unhex(event[1].as_str().expect("digits"));
                for flipped in flips(&datagram).filter(|flipped| read(flipped).is_err()) {
                    session.handle_datagram(Instant::ZERO, Peer(0), &Bytes::from(flipped));
                }
            }
            deliver(&mut session, event);
            if event[0] == "known" {
                let replica = session.replica().expect("a member");
                assert_eq!(known(replica), event[1], "{}", stream["name"]);
            }
        }
    }
}
