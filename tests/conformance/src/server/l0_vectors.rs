//! L0.11 to L0.14: golden vectors of client messages, sent to a server.
//!
//! Each vector is a case, named by its key. If a message has two faults, the server may find either first. For
//! example, an object named by the message may not exist, which is a valid reason to refuse it too.

use std::collections::BTreeSet;
use std::sync::Arc;

use rhumb_protocol::message::{Denial, ServerMessage, StreamChoice};
use rhumb_protocol::scene::{CommandError, Invalid};
use rhumb_protocol::session::CloseCode;
use serde_json::Value;

use super::scenery::lockstep;
use crate::case::Case;
use crate::grammar::unhex;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;
use crate::vectors::golden;

/// One vector.
#[derive(Clone, Debug)]
struct Vector {
    name: String,
    bytes: Vec<u8>,
    kind: u8,
    /// The reason why the command is refused, as `NotFinite 3`.
    error: Option<String>,
    /// Lengths at which the truncated body is well-formed too.
    cuts: Vec<usize>,
}

pub(super) fn cases() -> Vec<Case> {
    let vectors = vectors();
    // A server may skip a type from 128 on (3.5), malformed or not.
    let required = vectors
        .refused
        .iter()
        .filter(|vector| vector.kind < OPTIONAL);
    let refused = required.map(|vector| {
        let vector = vector.clone();
        let name = format!("refused: {}", vector.name);
        Case::server("L0.11", &name)
            .keyed(&vector.bytes)
            .cites(&format!("PROTOCOL 2.5-1, 2.5-3, {}", clause(&vector)))
            .play(move |trial| {
                let mut client = in_its_state(trial, vector.kind)?;
                client.send_bytes(&vector.bytes);
                client.must_be_closed(CloseCode::MALFORMED)
            })
    });
    let sent = vectors.sent.iter().map(|vector| {
        let vector = vector.clone();
        let (group, name) = match &vector.error {
            Some(_) => (
                "L0.13",
                format!("refused for an invalid number: {}", vector.name),
            ),
            None => ("L0.12", format!("understood: {}", vector.name)),
        };
        Case::server(group, &name)
            .keyed(&vector.bytes)
            .cites(&format!("PROTOCOL 2.5-2, {}", clause(&vector)))
            .play(move |trial| understood(trial, &vector))
    });
    let mut cases: Vec<_> = refused.chain(sent).collect();
    cases.extend(truncations(&vectors.sent));
    cases
}

/// Each kind of message, truncated at every length.
fn truncations(sent: &[Vector]) -> impl Iterator<Item = Case> {
    let mut kinds: Vec<u8> = sent.iter().map(|vector| vector.kind).collect();
    kinds.sort_unstable();
    kinds.dedup();
    let sent = Arc::new(sent.to_vec());
    kinds
        .into_iter()
        .filter(|kind| *kind < OPTIONAL)
        .map(move |kind| {
            let sent = Arc::clone(&sent);
            let name = format!(
                "a message of type {kind}, truncated at any length or with a trailing byte, is malformed"
            );
            Case::server(&format!("L0.14.{kind}"), &name)
                .cites("PROTOCOL 2.5-1, 4.1-4")
                .play(move |trial| cut(trial, &sent, kind))
        })
}

fn cut(trial: &mut Trial<'_>, sent: &[Vector], kind: u8) -> CaseResult {
    let short = |vector: &&Vector| vector.kind == kind && vector.bytes.len() < 60;
    // Two vectors of each kind suffice: every truncation needs a connection of its own.
    for vector in sent.iter().filter(short).take(2) {
        let (start, body) = body_of(&vector.bytes);
        let longer = [&vector.bytes[start..], &[0]].concat();
        for end in (0..=longer.len()).filter(|end| *end != body) {
            if vector.cuts.contains(&end) {
                continue;
            }
            trial.note(format!("{}, {end} bytes of {body}", vector.name));
            let mut client = in_its_state(trial, kind)?;
            let mut bytes = Vec::new();
            rhumb_protocol::message::frame(kind, &longer[..end], &mut bytes);
            client.send_bytes(&bytes);
            client.must_be_closed(CloseCode::MALFORMED)?;
            if let Some(end) = &client.ended
                && *end != rhumb_netsim::RawPeerEnd::Closed(CloseCode::MALFORMED.0.into())
            {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Start and length of the body of a framed message.
fn body_of(bytes: &[u8]) -> (usize, usize) {
    let length = bytes
        .iter()
        .position(|byte| byte & 0x80 == 0)
        .unwrap_or_default()
        + 1;
    (length + 1, bytes.len() - length - 1)
}

/// A client in a state in which a message of this type is allowed.
fn in_its_state(trial: &mut Trial<'_>, kind: u8) -> Result<RawClient, Stop> {
    let mut client = trial.client()?;
    match kind {
        HELLO => {}
        CREATE | SESSION | JOIN_CELLS => drop(client.hello()?),
        _ => {
            client.enter(lockstep(), StreamChoice::Full)?;
        }
    }
    Ok(client)
}

fn understood(trial: &mut Trial<'_>, vector: &Vector) -> CaseResult {
    let mut client = match vector.kind {
        JOIN => {
            let mut client = trial.client()?;
            client.hello()?;
            client.create(lockstep())?;
            client
        }
        kind => in_its_state(trial, kind)?,
    };
    client.send_bytes(&vector.bytes);
    match vector.kind {
        HELLO => greeted(&mut client),
        COMMAND => commanded(&mut client, vector),
        CREATE => {
            let answer = client.await_message("answer", |message| match message {
                ServerMessage::Created => Some(None),
                ServerMessage::Denied(Denial::InvalidConfig(invalid)) => {
                    Some(Some(broken_rule(&invalid)))
                }
                ServerMessage::Denied(other) => Some(Some(format!("{other:?}"))),
                _ => None,
            })?;
            match (&vector.error, answer) {
                (None, None) => Ok(()),
                (Some(error), Some(denial)) if *error == denial => Ok(()),
                (error, answer) => Stop::fail(format!("the answer is {answer:?}, not {error:?}")),
            }
        }
        _ => client.barrier().map(drop),
    }
}

/// The answer to a valid hello: a welcome, or a refusal for another valid reason. A server that asks for a token closes
/// with code 16, because the vectors show none.
fn greeted(client: &mut RawClient) -> CaseResult {
    let first = client.next_message()?;
    match (first, &client.ended) {
        (Some(ServerMessage::Welcome(welcome)), _) => ensure(welcome.version == 1, "version 1"),
        (None, Some(rhumb_netsim::RawPeerEnd::Closed(3 | 5))) => Ok(()),
        (None, Some(rhumb_netsim::RawPeerEnd::Closed(16))) if client.token.is_some() => Ok(()),
        other => Stop::fail(format!("the answer is {other:?}")),
    }
}

/// The rule and the quantity, as the vectors write them.
fn broken_rule(invalid: &Invalid) -> String {
    format!("{:?}({:?})", invalid.rule, invalid.quantity)
}

fn commanded(client: &mut RawClient, vector: &Vector) -> CaseResult {
    let outcome = client.outcome_of(0)?;
    let Some(error) = &vector.error else {
        return Ok(());
    };
    match outcome {
        Ok(_) => Stop::fail(format!("it is applied; it must be refused with {error}")),
        Err(
            CommandError::UnknownBody(_)
            | CommandError::UnknownShape(_)
            | CommandError::UnknownJoint(_)
            | CommandError::NotGranted(_),
        ) => Ok(()),
        Err(CommandError::UnknownCommand) if error == "UnknownCommand" => Ok(()),
        Err(CommandError::Invalid(invalid)) if broken_rule(&invalid) == *error => Ok(()),
        Err(CommandError::Invalid(invalid)) => Stop::fail(format!(
            "it is refused with {}, not {error}",
            broken_rule(&invalid)
        )),
        Err(other) => Stop::fail(format!("it is refused with {other:?}, not {error}")),
    }
}

const HELLO: u8 = 1;
const CREATE: u8 = 2;
const JOIN: u8 = 3;
const SESSION: u8 = 32;
const JOIN_CELLS: u8 = 128;
/// The first type that a server may skip.
const OPTIONAL: u8 = 128;
const COMMAND: u8 = 7;

/// The requirement about this type of message.
fn clause(vector: &Vector) -> &'static str {
    match vector.kind {
        HELLO => "3.5-12",
        CREATE => "3.3-1",
        JOIN | 12 => "4.2-1",
        COMMAND => "4.4-7",
        14 => "4.11-1",
        _ => "4.1-4",
    }
}

struct Vectors {
    sent: Vec<Vector>,
    refused: Vec<Vector>,
}

/// The vectors of client messages.
fn vectors() -> Vectors {
    let table = golden("control.json");
    let of = |section: &str| {
        let lines = table[section].as_array().expect("a section is a list");
        // Some vectors differ in one number only and have the same bytes without it.
        let mut seen = BTreeSet::new();
        let vectors = lines.iter().map(vector);
        vectors
            .filter(|vector| seen.insert(vector.bytes.clone()))
            .collect()
    };
    Vectors {
        sent: of("client messages"),
        refused: of("refused client messages"),
    }
}

fn vector(line: &Value) -> Vector {
    let bytes = unhex(line["bytes"].as_str().unwrap_or_default());
    let (start, _) = body_of(&bytes);
    let cuts = line["cuts"].as_array().into_iter().flatten();
    Vector {
        name: line["name"].as_str().unwrap_or_default().to_owned(),
        kind: bytes[start - 1],
        error: line["error"]["is"].as_str().map(|word| {
            let quantity = line["error"]["quantity"].as_u64();
            named(word, quantity)
        }),
        cuts: cuts
            .filter_map(Value::as_u64)
            .map(|cut| cut as usize)
            .collect(),
        bytes,
    }
}

/// A vector's error in the notation of this project's error types.
fn named(word: &str, quantity: Option<u64>) -> String {
    let quantity = quantity.and_then(|code| u8::try_from(code).ok());
    match quantity.and_then(rhumb_protocol::scene::Quantity::from_code) {
        Some(quantity) => format!("{word}({quantity:?})"),
        None => word.to_owned(),
    }
}
