//! Makes the golden vectors of the control stream.
//!
//! Messages are composed by hand from the document and decoded by the codec and by the table; the results of both are
//! recorded. `UPDATE_VECTORS=1 cargo test -p rhumb-tests --test in_process vectors` writes `spec/vectors/control.json`.

mod change;
mod client;
mod edges;
mod long;
mod message_case;
mod pieces;
mod scene_edges;
mod server;
pub mod streams;

use std::path::{Path, PathBuf};

use rhumb_conformance::grammar::{Grammar, hex};
use rhumb_conformance::vectors::{Decoded, Sender, error_json, framed_bytes};
use rhumb_protocol::scene::Invalid;
use serde_json::{Value, json};

pub(crate) use message_case::MessageCase;
use pieces::word;

/// The folder of the golden vectors.
#[must_use]
pub fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../spec/vectors")
}

/// The content of `control.json`.
#[must_use]
pub fn control() -> String {
    let grammar = Grammar::load();
    let mut sections = Vec::new();
    for (side, cases, edges, name) in [
        (Sender::Client, client::cases(), edges::client(), "client"),
        (Sender::Server, server::cases(), edges::server(), "server"),
    ] {
        let more = change::cases(&grammar, side, &cases);
        let all = cases.iter().chain(&more).chain(&edges);
        let (sent, refused) = lines(&grammar, side, all);
        sections.push(format!("\"{name} messages\": [\n{}\n]", sent.join(",\n")));
        sections.push(format!(
            "\"refused {name} messages\": [\n{}\n]",
            refused.join(",\n")
        ));
        let long = long::lines(&grammar, side).join(",\n");
        sections.push(format!("\"long {name} messages\": [\n{long}\n]"));
    }
    sections.push(format!("\"frames\": [\n{}\n]", frames().join(",\n")));
    let sections = sections.join(",\n");
    format!("{{\n\"format\": \"rhumb control vectors 1\",\n{sections}\n}}\n")
}

fn lines<'a>(
    grammar: &Grammar,
    side: Sender,
    cases: impl Iterator<Item = &'a MessageCase>,
) -> (Vec<String>, Vec<String>) {
    let (mut sent, mut refused) = (Vec::new(), Vec::new());
    for MessageCase {
        name,
        kind,
        body,
        rule,
    } in cases
    {
        let bytes = hex(&framed_bytes(*kind, body));
        let mut line = json!({"name": name, "bytes": bytes});
        if let Some(rule) = rule {
            line["rule"] = json!(rule);
        }
        let outcome = side.outcome(*kind, body);
        match outcome {
            Decoded::Refused(why) => {
                line["refusal"] = Value::String(word(why));
                refused.push(line.to_string());
                continue;
            }
            Decoded::Skipped => line["skipped"] = Value::Bool(true),
            Decoded::UnknownCommand => line["error"] = json!({"is": "UnknownCommand"}),
            Decoded::NoMotion(quantity) => {
                line["error"] = error_json(Invalid::not_finite(quantity));
            }
            Decoded::Accepted(invalid) => {
                if let Some(invalid) = invalid {
                    line["error"] = error_json(invalid);
                }
            }
        }
        let typed = [&[*kind], &body[..]].concat();
        line["means"] = match grammar.read(side.type_name(), &typed) {
            Ok((means, _)) => means,
            Err(why) => panic!("{name}: the codec accepts it, the table does not: {why:?}"),
        };
        line["cuts"] = json!(whole_at(side, *kind, body));
        sent.push(line.to_string());
    }
    (sent, refused)
}

/// Lengths up to one byte more at which the body, truncated or extended by a zero byte, is valid for its type.
fn whole_at(side: Sender, kind: u8, body: &[u8]) -> Vec<usize> {
    let longer = [body, &[0]].concat();
    let is_whole = |end: &usize| {
        let outcome = side.outcome(kind, &longer[..*end]);
        !matches!(outcome, Decoded::Refused(_))
    };
    (0..=longer.len())
        .filter(|end| *end != body.len())
        .filter(is_whole)
        .collect()
}

/// Byte streams, the messages in them, and the error that ends them.
fn frames() -> Vec<String> {
    let leave = [1_u8, 4];
    let (first, second) = (
        [&[0x81, 0x80, 0x01, 0][..], &[7; 16_384]].concat(),
        [3, 7, 8, 9],
    );
    let long = [&first[..], &second, &leave].concat();
    let endless = [&first[..], &[1, 7]].concat();
    let most = [&[0x81, 0x80, 0x01, 0xee][..], &[7; 16_384]].concat();
    let mut split = Vec::new();
    for (name, bytes, refusal) in [
        ("nothing", &[][..], None),
        ("one message", &leave, None),
        (
            "two messages and the beginning of a third",
            &[1, 4, 1, 5, 1],
            None,
        ),
        ("the beginning of a length", &[0xff], None),
        ("the longest", &most, None),
        ("a message without a type", &[0, 4], Some("OutOfRange")),
        ("one in pieces, and one behind it", &long, None),
        ("a piece, and no more yet", &first, None),
        ("a piece that is short", &[2, 0, 1], Some("NotCanonical")),
        ("a piece of nothing", &[1, 0], Some("NotCanonical")),
        ("a piece without a rest", &endless, Some("NotCanonical")),
        (
            "one byte more than the longest",
            &[0x82, 0x80, 0x01, 0xee],
            Some("TooLong"),
        ),
        (
            "a length in a longer form",
            &[0x81, 0x00, 4],
            Some("NotCanonical"),
        ),
        (
            "a length of more than 64 bits",
            &[0xff; 10],
            Some("TooLong"),
        ),
        (
            "a good message, then one without a type",
            &[1, 4, 0],
            Some("OutOfRange"),
        ),
    ] {
        split.push(frame_line(name, bytes, refusal));
    }
    split
}

fn frame_line(name: &str, bytes: &[u8], refusal: Option<&str>) -> String {
    let mut frames = rhumb_protocol::message::Frames::new();
    frames.push(bytes);
    let mut messages = Vec::new();
    let refused = loop {
        match frames.next_frame() {
            Ok(Some(framed)) => {
                messages.push(json!({"type": framed.kind, "body": hex(&framed.body)}));
            }
            Ok(None) => break None,
            Err(why) => break Some(format!("{why:?}")),
        }
    };
    assert_eq!(refused.as_deref(), refusal, "{name}");
    let mut line = json!({"name": name, "bytes": hex(bytes), "messages": messages});
    if let Some(why) = refused {
        line["refusal"] = Value::String(why);
    }
    line.to_string()
}
