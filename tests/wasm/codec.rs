//! The codec reads the golden vectors, and writes the messages as they were.

use std::path::Path;

use rhumb_protocol::message::{ClientMessage, Framed, Frames, ServerMessage};
use rhumb_protocol::packet::{
    Checksums, Datagram, FullPacket, LossReport, PacketKind, Refresh, RepairSymbol, UpdatePacket,
    Watermark,
};
use rhumb_protocol::wire::Malformed;
use serde_json::Value;

/// Meaning of a vector's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Refused,
    Accepted,
    /// An unknown optional message.
    Skipped,
    /// A command that a server answers by an error.
    Answered,
    /// They have a meaning, but are written otherwise: a fault.
    Changed,
}

fn vectors(name: &str) -> Value {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../spec/vectors");
    let text =
        std::fs::read_to_string(folder.join(name)).expect("the vectors are in the repository");
    serde_json::from_str(&text).expect("they are JSON")
}

fn bytes(case: &Value) -> Vec<u8> {
    let digits = case["bytes"].as_str().expect("a case has bytes");
    let byte = |at| u8::from_str_radix(&digits[at..at + 2], 16).expect("two digits");
    (0..digits.len()).step_by(2).map(byte).collect()
}

/// Checks each case of a list; the list has some.
fn each(
    cases: &Value,
    outcome: impl Fn(&[u8]) -> Outcome,
    expected: impl Fn(&Value) -> Vec<Outcome>,
) {
    let cases = cases.as_array().expect("a list");
    assert!(!cases.is_empty());
    for case in cases {
        let (found, expected) = (outcome(&bytes(case)), expected(case));
        assert!(
            expected.contains(&found),
            "{}: {found:?}, not {expected:?}",
            case["name"]
        );
    }
}

fn only(outcome: Outcome) -> impl Fn(&Value) -> Vec<Outcome> {
    move |_| vec![outcome]
}

fn meaning(case: &Value) -> Vec<Outcome> {
    match (case.get("skipped"), case.get("error")) {
        (Some(_), _) => vec![Outcome::Skipped],
        // A number out of range is found when the command is checked, or when it is decoded.
        (None, Some(_)) => vec![Outcome::Accepted, Outcome::Answered],
        (None, None) => vec![Outcome::Accepted],
    }
}

/// Reads one frame of the control stream, and writes its message.
fn message(
    bytes: &[u8],
    decode: impl Fn(&Framed, &mut Vec<u8>) -> Result<bool, Malformed>,
) -> Outcome {
    let mut frames = Frames::new();
    frames.push(bytes);
    let Ok(Some(framed)) = frames.next_frame() else {
        return Outcome::Refused;
    };
    let mut written = Vec::new();
    match decode(&framed, &mut written) {
        Ok(true) if written == bytes => Outcome::Accepted,
        Ok(true) => Outcome::Changed,
        Ok(false) => Outcome::Skipped,
        Err(Malformed::UnknownCommand | Malformed::Motion(_)) => Outcome::Answered,
        Err(_) => Outcome::Refused,
    }
}

fn of_client(bytes: &[u8]) -> Outcome {
    message(bytes, |framed, written| {
        let known = ClientMessage::decode(framed)?;
        Ok(known.map(|message| message.encode(written)).is_some())
    })
}

fn of_server(bytes: &[u8]) -> Outcome {
    let outcome = message(bytes, |framed, written| {
        let known = ServerMessage::decode(framed)?;
        Ok(known.map(|message| message.encode(written)).is_some())
    });
    // A client answers no message.
    if outcome == Outcome::Answered {
        Outcome::Refused
    } else {
        outcome
    }
}

fn packet(bytes: &[u8]) -> Outcome {
    if opened(bytes).is_ok() {
        Outcome::Accepted
    } else {
        Outcome::Refused
    }
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

#[test]
fn messages_are_read_and_written_again() {
    let control = vectors("control.json");
    each(&control["client messages"], of_client, meaning);
    each(&control["server messages"], of_server, meaning);
    each(
        &control["refused client messages"],
        of_client,
        only(Outcome::Refused),
    );
    each(
        &control["refused server messages"],
        of_server,
        only(Outcome::Refused),
    );
}

#[test]
fn packets_are_read_or_refused() {
    let (packets, scripted) = (vectors("packets.json"), vectors("scripted.json"));
    each(&packets["accepted"], packet, only(Outcome::Accepted));
    each(&packets["refused"], packet, only(Outcome::Refused));
    each(&scripted["refused"], packet, only(Outcome::Refused));
}
